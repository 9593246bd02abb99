"""Cells of CSV, which people open in spreadsheets."""

from pqsec_pki.errors import shown

_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""A spreadsheet may run a cell that begins with one of these (OWASP, CSV injection)."""


def cell(text: str) -> str:
    """`text` with an apostrophe before what a spreadsheet would run, and no control characters."""
    text = f"'{text}" if text.startswith(_FORMULA) else text
    return text if text.isprintable() else shown(text, len(text))
