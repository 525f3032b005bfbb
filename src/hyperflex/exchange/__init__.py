"""Exchange with other programs: set-ups as MuJoCo's MJCF, runs and recordings as MCAP."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.exchange.mcap import write_mcap
    from hyperflex.exchange.mjcf import read_mjcf, write_mjcf

__getattr__, __dir__, __all__ = attach(__name__, __file__)
