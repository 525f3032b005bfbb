"""The report of a planned cast: page, figures, film."""

from hyperflex.report.cast.report import CastReport

__all__ = ["CastReport"]
