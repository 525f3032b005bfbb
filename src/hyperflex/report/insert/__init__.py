"""The report of a planned insertion: page, figures, film."""

from hyperflex.report.insert.report import InsertReport

__all__ = ["InsertReport"]
