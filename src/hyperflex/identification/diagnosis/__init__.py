"""Diagnosis of a fit: what was held or declared and does not fit, and what the result may be used for."""
