"""Casting: throw a rope round a target, wind it and hold; whip: bring its tip fast through a point."""

from hyperflex.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
