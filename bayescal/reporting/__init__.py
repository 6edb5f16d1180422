"""Reports from results only: JSON, posterior.nc, figures, and the summary in the terminal."""
