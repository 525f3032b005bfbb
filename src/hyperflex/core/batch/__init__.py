"""Batch rollouts in SIMD lanes."""
