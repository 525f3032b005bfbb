"""The report of a planned whip: page, pictures, words."""
