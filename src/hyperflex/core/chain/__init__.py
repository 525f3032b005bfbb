"""The chain of rigid links: articulated-body algorithm, SIMD lanes, drive, drag."""
