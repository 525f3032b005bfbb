"""The report of a planned cast: page, figures, film."""

from hyperflex.report.cast.report import CastReport, plain_reason

__all__ = ["CastReport", "plain_reason"]
