"""Which contacts to measure, and the uncertainty that can be expected of them."""
