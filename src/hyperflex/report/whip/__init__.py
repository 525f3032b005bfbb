"""whip."""
