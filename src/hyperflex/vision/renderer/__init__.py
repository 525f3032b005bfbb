"""A synthetic camera: pictures of a simulated rope with their ground truth, for tests and examples."""
