"""Reports of a plan: terminal, JSON, table of contacts, figure, page."""
