"""Reports of a fit: terminal, JSON, netCDF."""
