"""Validation: measured errors of the calibrated arm against predicted uncertainty and certified values."""
