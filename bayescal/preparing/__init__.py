"""Before a fit: a new dataset folder, and the check of one."""
