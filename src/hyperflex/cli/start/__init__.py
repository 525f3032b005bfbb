"""Commands to begin with: the demo, a set-up file, compiled kernels, and whether the installation is sound."""
