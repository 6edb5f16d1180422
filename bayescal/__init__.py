"""bayescal: Bayesian calibration of robot arms from probed planes, with its uncertainty."""

__version__ = "0.1.0"
