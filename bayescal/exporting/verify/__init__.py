"""A written file in its simulator: against the fitted arm, and against the measurements."""
