"""Whips: the tip passes a point fast, in a given direction."""
