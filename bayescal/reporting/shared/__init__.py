"""What all reports share: numbers as text, origin of a result."""
