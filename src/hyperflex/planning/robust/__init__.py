"""Uncertainty: sampled scenarios, robust refinement of throws, and their success probability."""
