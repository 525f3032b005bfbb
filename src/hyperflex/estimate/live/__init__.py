"""Live estimation: frames as they come, what is made of each, log, page, and a state source."""
