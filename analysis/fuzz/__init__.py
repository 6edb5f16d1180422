"""Damaged input: no traceback, no hang, no wrong number in silence."""
