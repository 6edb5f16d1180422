"""Targets and programs of the nominal arm, changed so that the calibrated arm reaches them."""
