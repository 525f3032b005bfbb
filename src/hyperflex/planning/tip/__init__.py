"""Strokes after which the tip does what a task asks at one instant: what whips and insertions have in common."""
