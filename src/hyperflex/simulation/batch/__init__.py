"""Batch rollouts: in SIMD lanes, or with contact on threads."""
