"""The report of an identification: page, pictures, tables."""
