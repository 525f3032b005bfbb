"""Insertions: the tip goes through a slot between two walls, to a depth, and the rope touches neither."""
