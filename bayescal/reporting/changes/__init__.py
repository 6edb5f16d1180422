"""Reports of what changed between sessions of an arm, and of its history."""
