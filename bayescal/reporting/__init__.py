"""Reports from results alone: fit.json, posterior.nc, and the terminal's summary."""
