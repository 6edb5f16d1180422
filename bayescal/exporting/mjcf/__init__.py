"""The fitted arm as a MuJoCo model (MJCF): a new file, or a given file patched in place."""
