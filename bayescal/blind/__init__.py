"""The blind check: worlds of another making, in which something withheld is wrong."""
