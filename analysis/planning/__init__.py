"""Plans checked on simulated sessions: what they promise, and what is measured."""
