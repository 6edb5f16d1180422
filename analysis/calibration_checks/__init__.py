"""Checks of the probabilities that a fit states: ranks of true values, joint and interval coverage."""
