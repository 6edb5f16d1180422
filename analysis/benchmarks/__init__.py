"""How fast the package is beside others on one problem: one peer a file, all on one core in one run."""
