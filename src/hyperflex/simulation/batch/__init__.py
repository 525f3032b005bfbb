"""Many rollouts at once: in SIMD lanes, or beside pegs on threads."""
