"""Commands to begin with: a set-up file, compiled kernels, and whether the installation is sound."""
