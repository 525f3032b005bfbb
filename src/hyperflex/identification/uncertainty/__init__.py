"""Uncertainty of a fit: noise, covariance, profile likelihood, intervals, bootstrap."""
