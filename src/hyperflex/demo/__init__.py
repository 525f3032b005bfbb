"""The demo: from a bundled recording to an identified rope to a cast that winds, with a report."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.demo.report import Demo, Parameter, write_demo

__getattr__, __dir__, __all__ = attach(__name__, __file__)
