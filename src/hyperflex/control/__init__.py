"""Control of a cast: pseudo-energy, the paper's timing rule, better rules, and the loop that they run in."""

from hyperflex.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
