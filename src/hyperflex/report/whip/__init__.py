"""The report of a planned whip: page, figures, film, and its words for the command line."""

from hyperflex.report.whip.report import whip_report, write_whip

__all__ = ["whip_report", "write_whip"]
