"""The report of a planned whip: page, figures, film."""

from hyperflex.report.whip.report import WhipReport

__all__ = ["WhipReport"]
