"""What to measure next, and what the session cannot show."""
