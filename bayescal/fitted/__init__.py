"""The fitted arm of a run at any pose, its file, and what it may be used for."""
