"""Identification: from a recording and a first guess to a rope with uncertainties."""

from hyperflex.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
