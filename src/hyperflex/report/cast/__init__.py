"""The report of a planned cast: page, figures, film, and its words for the command line."""

from hyperflex.report.cast.report import cast_report, write_cast

__all__ = ["cast_report", "write_cast"]
