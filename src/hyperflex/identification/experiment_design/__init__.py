"""experiment_design."""
