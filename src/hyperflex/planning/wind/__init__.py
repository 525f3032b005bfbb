"""Winding: the throw, whether a target can be wound, what became of it, and what would help."""
