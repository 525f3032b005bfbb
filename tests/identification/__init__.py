"""Identification, by the parts of it."""
