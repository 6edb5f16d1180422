"""The blind check: sealed worlds, answers given before their truth is opened, and the score card."""
