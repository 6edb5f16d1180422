"""Set-ups of new sessions: a commented dataset.yaml, an empty table, and what to measure."""
