"""A planned cast followed in closed loop."""
