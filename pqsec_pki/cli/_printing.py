"""How commands print: results as lines or JSON, and notes."""

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import click

from pqsec_pki.cli._settings import settings
from pqsec_pki.errors import FileError, shown

JSON_VERSION = 1
"""Of what commands print with --json: a key that goes or changes its meaning makes it one more."""


def emit(
    value: Mapping[str, object] | None, lines: Iterable[str], *, verbatim: bool = False
) -> None:
    """Print the result: `value` as JSON, or `lines` for a person. FileError on a full disk.

    Lines of a document are printed `verbatim`; in others, what a terminal would obey is escaped.
    """
    if settings().json:
        text = as_json(value or {})
    else:
        text = "\n".join(lines if verbatim else map(printable, lines))
    if text:
        with advising("what was asked for is done all the same"):
            say(text)


def as_json(value: Mapping[str, object]) -> str:
    """The result for a program, with the version of its format."""
    return json.dumps({"version": JSON_VERSION, **value}, indent=2)


def say(text: str) -> None:
    """Print a part of the result as it is; FileError on a full disk."""
    try:
        click.echo(text)
    except OSError as error:
        # Python flushes again as it ends; what is left of the result goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        reason = (error.strerror or str(error)).lower()
        raise FileError(f"the result cannot be printed: {reason}") from error


@contextmanager
def advising(hint: str) -> Iterator[None]:
    """Let a FileError that passes through here say what to do: the work itself is done."""
    try:
        yield
    except FileError as error:
        error.hint = hint
        raise


def note(text: str) -> None:
    """Tell the user something that is not the result."""
    click.echo(f"pqsec: note: {printable(text)}", err=True)


def printable(text: str) -> str:
    """`text` without what a terminal would obey: names of files are anybody's choice."""
    return text if text.isprintable() else shown(text, len(text))


def counted(number: int, what: str) -> str:
    """1 file, 2 files."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    """The lines of a table with columns as wide as they must be."""
    grid = [heads, *rows]
    widths = [max(len(row[column]) for row in grid) for column in range(len(heads))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in grid
    ]
