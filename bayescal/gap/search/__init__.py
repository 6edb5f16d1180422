"""The search for effects: candidates, generic cells, sets of effects, verdict."""
