"""The demo: from a bundled recording to an identified rope to a cast that winds, with a report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.demo.report import DemoReport, write_demo

__all__ = ["DemoReport", "write_demo"]

__getattr__ = loader(__name__, __file__)
