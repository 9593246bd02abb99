"""pqsec log: show and verify the ledger."""

import re

import click

from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.errors import UsageError, VerificationError
from pqsec_pki.keystore import Keystore, Line, audit

_SHA256 = 64
"""Hexadecimal digits."""
_HEAD = re.compile(f"[0-9a-f]{{{_SHA256}}}")
_HEADERS = ("line", "when", "who", "what", "name", "serial or hash")


@_help.command(
    examples={
        "Show the ledger": "pqsec log",
        "Check that nothing was changed or removed": "pqsec log --verify",
    },
    exit_codes={
        0: "shown; with --verify, the ledger is complete",
        1: "with --verify or --head: the ledger or a file was changed",
        3: "the keystore cannot be read",
    },
)
@click.option(
    "--verify", is_flag=True, help="Check that no line was changed or removed, and none is missing."
)
@click.option(
    "--head", metavar="HASH", help="Check against the head that an earlier --verify printed."
)
@_settings.command_options
def log(*, verify: bool, head: str | None) -> None:
    """Show or verify the ledger of everything issued, signed and revoked.

    --verify checks the chain of hashes, and that every file in the keystore has an entry.
    Keep the head that it prints in another place: --head then detects a ledger that was
    truncated or rewritten.
    """
    if head is not None and not _HEAD.fullmatch(head):
        raise UsageError(
            f"{head!r} is not a head: it has {_SHA256} hexadecimal digits",
            hint="`pqsec log --verify` prints it",
        )
    keystore = _settings.open_keystore()
    if verify or head is not None:
        _verify(keystore, head)
        return
    lines = keystore.lines()
    _printing.emit({"lines": lines}, _printing.table(_HEADERS, map(_row, lines)))


def _verify(keystore: Keystore, head: str | None) -> None:
    try:
        count, newest = audit(keystore, head)
    except VerificationError as error:
        if _settings.settings().json:
            _printing.emit({"ok": False, "problems": error.lines}, [])
        raise
    value = {"ok": True, "lines": count, "head": newest}
    _printing.emit(value, [f"the ledger is complete: {count} lines, head {newest}"])


_JSON_ONLY = {"keys"}
"""Details that only --json shows."""


def _row(line: Line) -> tuple[str, ...]:
    entry = line.entry
    details_shown = {
        key: _short(v) for key, v in entry.details.items() if v and key not in _JSON_ONLY
    }
    details = ", ".join(f"{key} {value}" for key, value in details_shown.items())
    what = f"{entry.kind} ({details})" if details else entry.kind
    last = entry.serial or entry.sha256[:16]
    return (str(line.number), entry.at[:16], entry.operator or "-", what, entry.name or "-", last)


def _short(value: str) -> str:
    """The first 16 digits of a hash; anything else unchanged."""
    return value[:16] if len(value) == _SHA256 else value
