"""stiction."""
