"""Assessment of a result: identifiability, probed directions, agreement of sessions, tests, warnings."""
