"""Commands to begin with: a set-up file, the demo, compiled kernels, and whether the installation is sound."""
