"""--format: a list as a table, as JSON or as CSV."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from io import StringIO

import click

from pqsec_pki._csv import cell
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli._times import for_programs
from pqsec_pki.errors import UsageError

TABLE, JSON, CSV = "table", "json", "csv"


def option(*others: str) -> Callable[[_settings.Command], _settings.Command]:
    """Add --format with table, json, csv and `others`; give its value `form` to `chosen`."""

    def remember(context: click.Context, parameter: click.Parameter, value: str) -> str:
        del parameter
        if value == JSON:
            _settings.settings(context).json = True
        return value

    return click.option(
        "--format",
        "form",
        type=click.Choice([TABLE, JSON, CSV, *others]),
        default=TABLE,
        show_default=True,
        callback=remember,
        help="Print in this format; json is the same as --json.",
    )


def chosen(form: str) -> str:
    """The format to print, JSON with --json. UsageError for --json and another format."""
    if not _settings.settings().json:
        return form
    if form not in {TABLE, JSON}:
        raise UsageError(f"--json and --format {form} exclude each other")
    return JSON


def emit(
    form: str,
    value: Mapping[str, object],
    lines: Iterable[str],
    *,
    columns: Sequence[str],
    items: Iterable[Mapping[str, object]],
) -> None:
    """Print `value` as JSON, `items` as CSV, or `lines`. FileError on a full disk.

    An item is what JSON has for it; `columns` are the keys that CSV shows, in their order.
    UsageError as from `chosen`.
    """
    if chosen(form) == CSV:
        _printing.emit(None, as_csv(columns, items), verbatim=True)
    else:
        _printing.emit(value, lines)


def as_csv(columns: Sequence[str], items: Iterable[Mapping[str, object]]) -> Iterator[str]:
    """One line for the columns, then one for each item (RFC 4180, without the line ends).

    Control characters are escaped. A cell that a spreadsheet might run gets a `'` in front.
    """
    yield _row(columns)
    for item in items:
        yield _row(for_programs(cell(_text(item.get(column)))) for column in columns)


def _row(cells: Iterable[str]) -> str:
    text = StringIO()
    csv.writer(text, lineterminator="").writerow(cells)
    return text.getvalue()


def _text(value: object) -> str:
    """A value of JSON as text: nothing for null, the parts of a list separated by spaces."""
    if value is None:
        return ""
    if isinstance(value, bool | Mapping):
        return json.dumps(value)
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, Iterable) and not isinstance(value, str):
        return " ".join(map(_text, value))
    return str(value)
