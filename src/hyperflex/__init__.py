"""hyperflex: robots that use a rope as an arm. Identify it, simulate it, cast it.

Public names are loaded on first use, so that ``import hyperflex`` stays quick.
"""

from hyperflex.lazy import attach

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = attach(__name__, __file__)
