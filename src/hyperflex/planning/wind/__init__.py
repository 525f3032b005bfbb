"""wind."""
