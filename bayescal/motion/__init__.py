"""The gap of motions: joint logs against the torques of the model."""
