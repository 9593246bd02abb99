"""Long results of commands that only show something go through a pager on a terminal, as git's do.

$PAGER, else less or more. NO_PAGER, TERM=dumb, --no-pager and what fits on the screen need none.
"""

import os
import shutil
import sys

import click

from pqsec_pki.cli._settings import Command

_WANTED = f"{__name__}.wanted"
"""The key in a context's `meta`."""
_LESS = "FRX"
"""The options of git: end if all fits on the screen, show colours, leave the text there."""


def option(command: Command) -> Command:
    """Add --no-pager to a command, whose long results are paged without it."""

    def remember(context: click.Context, parameter: click.Parameter, value: object) -> None:
        del parameter
        context.meta[_WANTED] = not value

    return click.option(
        "--no-pager",
        is_flag=True,
        expose_value=False,
        callback=remember,
        help="Print a long result as it is; on a terminal it goes through $PAGER.",
    )(command)


def is_for(text: str) -> bool:
    """Whether the text goes through a pager."""
    if not click.get_current_context().meta.get(_WANTED) or not sys.stdout.isatty():
        return False
    if os.environ.get("NO_PAGER") or os.environ.get("PAGER") in {"", "cat"}:
        return False
    if not sys.stdin.isatty() or os.environ.get("TERM", "") in {"", "dumb"}:
        return False
    columns, rows = shutil.get_terminal_size()
    return sum(1 + len(line) // columns for line in text.splitlines()) >= rows


def show(text: str) -> None:
    """Show it until the user ends the pager, which changes no exit code."""
    os.environ.setdefault("LESS", _LESS)
    click.echo_via_pager(f"{text}\n")
