"""A session while it is measured: its rows as they are written, and the estimate after each contact."""
