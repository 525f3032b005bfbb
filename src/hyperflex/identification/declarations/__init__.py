"""Tests of what was declared of a recording or held in a fit; held.py lists most of them, as HELD."""
