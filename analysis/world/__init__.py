"""Independent simulator of test sessions: rigid bodies in Pinocchio, with errors that are not disclosed."""
