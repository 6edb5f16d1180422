"""Worlds of another making: rigid bodies in Pinocchio, in which something is wrong that is not disclosed."""
