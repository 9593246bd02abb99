"""Asks before a change that a user should see first."""

import sys
from collections.abc import Callable

import click

from pqsec_pki.cli import _progress, _settings
from pqsec_pki.errors import UsageError


def confirm(show: Callable[[], None], question: str, *, what: str, hint: str) -> None:
    """Call `show`, then ask; click.Abort for a no.

    UsageError with `what` and `hint` if there is no terminal to ask, or with --json.
    """
    if _settings.settings().json:
        raise UsageError("--json does not ask for confirmation", hint=hint)
    show()
    if not sys.stdin.isatty():
        raise UsageError(f"{what}, and no terminal to ask", hint=hint)
    with _progress.hidden():
        click.confirm(question, abort=True, err=True)
