"""Dry joint friction: slip modes, and the constraint torques of stuck joints."""
