"""Compiled kernels on trusted arrays: numbers only, no I/O, no exceptions; failures are status codes."""
