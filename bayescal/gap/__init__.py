"""The gap between model and machine: how big, where, which effect, how far it shrinks, what to probe next."""
