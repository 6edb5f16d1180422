"""The study: over many simulated sessions, is the arm found, and as surely as is said."""
