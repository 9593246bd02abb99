"""Print results, as lines or JSON, and notes."""

import json
import os
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from datetime import datetime
from itertools import zip_longest
from pathlib import PurePath
from textwrap import wrap

import click

from pqsec_pki.cli import _pager, _progress
from pqsec_pki.cli._colour import on_terminal, painted
from pqsec_pki.cli._settings import settings
from pqsec_pki.cli._times import for_programs, local
from pqsec_pki.errors import FileError, shown

JSON_VERSION = 1
"""The version of the JSON that commands print: removing a key, or changing its meaning, increases
it."""
_GAP = "  "
_NARROWEST = 16
"""Columns: a table is not wrapped into less."""
_SHOWN = 5
"""The most names on one line; --json has all."""


def emit(
    value: Mapping[str, object] | None, lines: Iterable[str], *, verbatim: bool = False
) -> None:
    """Print `value` as JSON with --json, else `lines`. FileError on a full disk.

    Control characters are escaped and times are in the zone of the reader, except in the lines of
    a document (`verbatim`).
    """
    if settings().json:
        text = as_json(value or {})
    else:
        text = "\n".join(lines if verbatim else _shown(lines))
    if text:
        with with_hint("the command itself succeeded"):
            say(text)


def _shown(lines: Iterable[str]) -> Iterator[str]:
    texts = map(for_people, lines)
    return map(painted, texts) if on_terminal(sys.stdout) else texts


def as_json(value: Mapping[str, object]) -> str:
    """The result for a program, with the version of its format."""
    text = json.dumps({"version": JSON_VERSION, **value}, indent=2, default=_encoded)
    return for_programs(text)


def _encoded(value: object) -> object:
    """What json.dumps writes for a value that it does not know.

    A value of a room is what its to_json returns, else its fields, without those that its repr
    leaves out, such as keys.
    """
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, PurePath):
        return str(value)
    if to_json := getattr(value, "to_json", None):
        return to_json()
    if is_dataclass(value):
        return {each.name: getattr(value, each.name) for each in fields(value) if each.repr}
    if isinstance(value, Iterable) and not isinstance(value, bytes):
        return list(value)
    raise TypeError(f"a {type(value).__name__} has no form in JSON")


def say(text: str) -> None:
    """Print a part of the result unchanged. FileError on a full disk."""
    try:
        with _progress.hidden():
            (_pager.show if _pager.is_for(text) else click.echo)(text)
    except OSError as error:
        # Python flushes again at exit: discard the rest of the result.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        reason = (error.strerror or str(error)).lower()
        raise FileError(f"the result cannot be printed: {reason}") from error


@contextmanager
def with_hint(hint: str) -> Iterator[None]:
    """Set the hint of a FileError raised inside: the work itself is already done."""
    try:
        yield
    except FileError as error:
        error.hint = hint
        raise


def note(text: str) -> None:
    """Print a note on stderr."""
    line = f"pqsec: note: {for_people(text)}"
    with _progress.hidden():
        click.echo(painted(line) if on_terminal(sys.stderr) else line, err=True)


def for_people(text: str) -> str:
    """`text` as a line for people: printable, with its times in their zone."""
    return local(printable(text))


def printable(text: str) -> str:
    """`text` with control characters escaped: file names may contain terminal commands."""
    return text if text.isprintable() else shown(text, len(text))


def counted(number: int, what: str) -> str:
    """Such as "1 file" or "2 files"."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def percent(share: float) -> str:
    """Such as "5%" for 0.05, as the options take it."""
    return f"{share * 100:.3g}%"


def few(names: Iterable[str]) -> str:
    """The names, shortened to fit on one line."""
    some = [name for name in names if name]
    if len(some) <= _SHOWN:
        return ", ".join(some)
    return f"{', '.join(some[: _SHOWN - 1])} and {len(some) - _SHOWN + 1} more"


def numbered(texts: Iterable[str]) -> Iterator[str]:
    """The texts as a numbered list."""
    return (f"  {number}. {text}" for number, text in enumerate(texts, start=1))


def table(headers: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    """The lines of a table with aligned columns; on a terminal, as wide as that.

    Then the cells of the widest columns are wrapped between words: no name is cut, so a line that
    cannot be as short is longer.
    """
    grid = [headers, *(tuple(map(local, row)) for row in rows)]
    widths = _widths(grid, _room())
    grid = [line for row in grid for line in _wrapped(row, widths)]
    line = _GAP.join(f"{{:{width}}}" for width in widths).format
    return [line(*row).rstrip() for row in grid]


def _room() -> int:
    """The columns of the terminal; a pipe has no end."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else sys.maxsize


def _widths(grid: Sequence[tuple[str, ...]], room: int) -> list[int]:
    """The columns' widths: the widest are made narrower, but not than a word in them."""
    columns = list(zip(*grid, strict=True))
    widths = [max(map(len, cells)) for cells in columns]
    excess = sum(widths) + len(_GAP) * (len(widths) - 1) - room
    if excess > 0:
        words = [max(map(len, " ".join(cells).split()), default=0) for cells in columns]
        least = [max(word, min(_NARROWEST, now)) for word, now in zip(words, widths, strict=True)]
        for column in sorted(range(len(widths)), key=lambda each: -widths[each]):
            narrower = min(max(excess, 0), widths[column] - least[column])
            widths[column] -= narrower
            excess -= narrower
    return widths


def _wrapped(row: tuple[str, ...], widths: Sequence[int]) -> Iterable[tuple[str, ...]]:
    """The row; what does not fit in a column is below."""
    cells = (
        [cell]
        if len(cell) <= width
        else wrap(cell, width, break_long_words=False, break_on_hyphens=False)
        for cell, width in zip(row, widths, strict=True)
    )
    return zip_longest(*cells, fillvalue="")
