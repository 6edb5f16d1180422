"""Assessment of a result: identifiability, probed directions, agreement of sessions, tests, warnings."""

from bayescal.storage.reading import table_beside

WORDS = table_beside(__file__, "words.toml")
"""Sentences on the results of a fit."""
