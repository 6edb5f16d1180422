"""Checks of a dataset before anything is fitted: units, plausibility, the robot, orientations."""
