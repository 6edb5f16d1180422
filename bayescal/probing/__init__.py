"""Clearance of an arm with its tool among solids, its free motions, and the search for contacts."""
