"""Tests of what was declared of a recording or held in a fit; registry.py lists them."""
