"""Cells of CSV, which people open in spreadsheets."""

import re

from pqsec_pki.errors import shown

_FORMULA = re.compile(r'\A(?=[=+@\t\r\n-])|(?<=;)(?="*[=+@-])')
"""A spreadsheet may run a cell that begins with one of these (OWASP, CSV injection). In countries
with a decimal comma it separates cells by semicolons."""


def cell(text: str) -> str:
    """`text` with an apostrophe before what a spreadsheet would run, and no control characters."""
    text = _FORMULA.sub("'", text)
    return text if text.isprintable() else shown(text, len(text))
