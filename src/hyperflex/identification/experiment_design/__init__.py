"""Design of experiments by Fisher information."""
