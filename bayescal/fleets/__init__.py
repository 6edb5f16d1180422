"""Many arms of one model: what their fits have in common, and which of them differ."""
