"""Uncertainty of a fit: noise, covariance, profile likelihood and intervals."""
