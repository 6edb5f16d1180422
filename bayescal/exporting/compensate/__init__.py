"""Compensated targets: readings that put the tool of a fitted arm where a table or a program wants it."""
