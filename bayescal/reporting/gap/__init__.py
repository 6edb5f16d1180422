"""Reports of a diagnosis: terminal, JSON, figures."""
