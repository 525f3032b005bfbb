"""Simulation: :func:`simulate` for whole runs, :func:`simulate_batch` for many, :func:`sensitivities` for derivatives.

:func:`angles` and :class:`Slopes` give the bare arrays that identification needs.
"""

from hyperflex.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
