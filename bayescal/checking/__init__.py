"""A dataset before anything is fitted: what is understood, what is missing, what looks wrong."""
