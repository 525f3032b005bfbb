"""The demo: from a bundled recording to an identified rope to a cast that winds, with a report."""

from hyperflex.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
