"""Compensated targets on the independent simulator: do distance errors fall to what was predicted."""
