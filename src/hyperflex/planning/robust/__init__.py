"""Casts planned for what is not known exactly: scenarios and probabilities of success."""
