"""Many rollouts side by side in SIMD lanes."""
