"""Casts: feasibility check, planner, plan, fallback targets and remedies."""
