"""Live estimation: frames as they come, what is made of each, the log, pictures of it, and a state source of its own."""
