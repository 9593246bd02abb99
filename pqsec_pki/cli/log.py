"""pqsec log: everything that was issued, signed and taken back, and that nobody altered it."""

import click

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import Keystore, Line, audit

_SHA256 = 64
"""Hexadecimal digits."""
_HEADS = ("line", "when", "who", "what", "name", "serial or hash")


@click.command()
@click.option(
    "--verify", is_flag=True, help="Check that no line was altered or removed, and none missing."
)
@click.option("--head", metavar="HASH", help="With --verify: the head an earlier --verify printed.")
@_settings.command_options
def log(*, verify: bool, head: str | None) -> None:
    """Show the ledger: every certificate, document and revocation made here.

    --verify checks the chain of hashes, and that all that lies in the keystore was
    entered. Keep the head it prints elsewhere: with --head, a ledger that was cut or
    written anew shows.
    """
    keystore = _settings.open_keystore()
    if verify or head is not None:
        _verify(keystore, head)
        return
    lines = keystore.lines()
    _printing.emit({"lines": list(map(_value, lines))}, _printing.table(_HEADS, map(_row, lines)))


def _verify(keystore: Keystore, head: str | None) -> None:
    try:
        count, newest = audit(keystore, head)
    except VerificationError as error:
        if _settings.settings().json:
            _printing.emit({"ok": False, "problems": error.lines}, [])
        raise
    _printing.emit({"ok": True, "lines": count, "head": newest}, [f"{count} lines, head {newest}"])


_FOR_MACHINES = {"keys"}
"""Details that --json has alone."""


def _row(line: Line) -> tuple[str, ...]:
    entry = line.entry
    told = {key: _short(v) for key, v in entry.details.items() if v and key not in _FOR_MACHINES}
    details = ", ".join(f"{key} {value}" for key, value in told.items())
    what = f"{entry.kind} ({details})" if details else entry.kind
    last = entry.serial or entry.sha256[:16]
    return (str(line.number), entry.at[:16], entry.operator or "-", what, entry.name or "-", last)


def _short(value: str) -> str:
    """A hash by its beginning, anything else as it is."""
    return value[:16] if len(value) == _SHA256 else value


def _value(line: Line) -> dict[str, object]:
    entry = line.entry
    return {
        "number": line.number,
        "at": entry.at,
        "operator": entry.operator,
        "kind": entry.kind,
        "name": entry.name,
        "serial": entry.serial,
        "issuer": entry.issuer,
        "sha256": entry.sha256,
        "not_after": entry.not_after,
        "details": entry.details,
        "chain": line.chain,
    }
