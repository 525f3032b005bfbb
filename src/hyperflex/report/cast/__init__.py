"""The report of a planned cast: page, pictures, words."""
