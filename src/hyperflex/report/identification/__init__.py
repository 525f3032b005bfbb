"""The report of an identification: page, figures, tables."""

from hyperflex.report.identification.page import identification_page, write_found, write_identification

__all__ = ["identification_page", "write_found", "write_identification"]
