"""The public API behind ``import bayescal``: functions that take a dataset or its path, and results."""
