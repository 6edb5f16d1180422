"""What a result is worth: identifiability, directions probed, agreement of sessions, false comfort."""
