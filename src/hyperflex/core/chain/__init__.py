"""The chain of rigid links: articulated-body algorithm, SIMD lanes, prescribed motion and motor torque."""
