"""An exported arm in the program that will read it, compared with the model."""
