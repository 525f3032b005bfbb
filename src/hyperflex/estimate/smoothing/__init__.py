"""Estimation of several frames at once: a moving horizon, and the smoother of a whole recording."""
