"""A synthetic camera: pictures of a simulated rope, with the truth beside them, for tests and examples."""
