"""What each method of the survey is worth on the same simulated sessions."""
