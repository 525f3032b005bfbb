"""The fit: multiple shooting over windows, from short to long."""
