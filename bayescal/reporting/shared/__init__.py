"""Shared by all reports: numbers as text, origin of a result."""
