"""Comparison of models by evidence."""
