"""Exact derivatives of rollouts."""
