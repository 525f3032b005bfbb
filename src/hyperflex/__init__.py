"""hyperflex."""
