"""What changed between sessions of one arm, and what its runs tell over time."""
