"""Colour on a terminal: what words say already is easier to find. It is never alone.

Red is a no or an error, yellow what needs care, green a yes. NO_COLOR (no-color.org) and TERM=dumb
turn it off, and so does everything that is not a terminal.
"""

import os
import re
from typing import TextIO

import click

_MEANINGS = {
    "red": r"^pqsec: error:|^FAIL\b|\bexpired(?=  +[0-9-]{10}\b)"
    r"|(?<=: )error(?= [A-Z]{2,8}[0-9]+ )",
    "yellow": r"^pqsec: (?:note|warning):"
    r"|\b(?:due|revoked|gone|previous-ca|incomplete)(?=  +[0-9-]{10}\b)"
    r"|(?<=: )warning(?= [A-Z]{2,8}[0-9]+ )",
    "green": r"^ok\b|\bvalid(?=  +[0-9-]{10}\b)",
    "cyan": r"^pqsec: hint:|(?<=: )info(?= [A-Z]{2,8}[0-9]+ )",
}
"""Colour -> the words that have it, where lines of pqsec have them."""
_WORDS = re.compile("|".join(f"(?P<{colour}>{words})" for colour, words in _MEANINGS.items()))


def on_terminal(stream: TextIO) -> bool:
    """Whether what is printed there may have colours."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def painted(line: str) -> str:
    """The line, with its first word that has a meaning in colour."""
    return _WORDS.sub(lambda found: click.style(found[0], fg=found.lastgroup), line, count=1)
