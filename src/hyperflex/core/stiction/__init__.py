"""Dry joint friction: which joints slip or stick, and the constraint torques of those that stick."""
