"""Batch rollouts in SIMD lanes, and where their samples come near something."""
