"""pqsec log: show and verify the ledger."""

import re
from collections.abc import Container, Iterable
from contextlib import suppress
from datetime import datetime
from pathlib import Path

import click

from pqsec_pki._times import said
from pqsec_pki.cli import _completion, _formats, _help, _pager, _passphrases, _printing, _settings
from pqsec_pki.errors import KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import (
    PERMITTED,
    Entry,
    Keystore,
    Line,
    SigningCa,
    audit,
    nearest,
    older_copies,
    read_anchors,
    regular_name,
    superseded_certificates,
    write_anchor,
)
from pqsec_pki.lifecycle import sign_head

_SHA256 = 64
"""Hexadecimal digits."""
_HEAD = re.compile(f"[0-9a-f]{{{_SHA256}}}")
_COLUMNS = (
    *("number", "at", "operator", "kind", "name", "serial"),
    *("issuer", "sha256", "not_after", "details", "chain", "superseded"),
)
_PARTICIPANT = "participant"
_HEADERS = ("line", "when", "who", "what", "name", "serial or hash")


def _head(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    """The value of --head; UsageError if it is not a head."""
    del context, parameter
    if value is None or _HEAD.fullmatch(value):
        return value
    raise UsageError(
        f"{value!r} is not a head: it has {_SHA256} hexadecimal digits",
        hint="`pqsec log --verify` prints it",
    )


@_help.command(
    examples={
        "Show the ledger": "pqsec log",
        "Show what was done for a robot in the last week": "pqsec log '/fleet/**' --since 7d",
        "Check that nothing was changed or removed": "pqsec log --verify",
        "Keep the newest signed head in another place": "pqsec log --anchor anchors",
        "Compare the ledger with the heads that are kept there": (
            "pqsec log --verify --anchor anchors"
        ),
    },
    exit_codes={
        0: "shown; the ledger is complete; the head is signed or kept",
        1: "with --verify, --head, --sign or --anchor: the ledger or a file was changed",
        3: (
            "the keystore cannot be read, a file not written, DIR has no heads to compare with, or"
            " the passphrase is wrong"
        ),
    },
)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_completion.participants)
@click.option(
    "--since",
    type=_settings.When(ago=True),
    metavar="WHEN",
    help="Show only lines from this time on: 2027-01-31, or 7d ago.",
)
@_formats.option()
@click.option(
    "--verify", is_flag=True, help="Check that no line was changed or removed, and none is missing."
)
@click.option(
    "--head",
    metavar="HASH",
    callback=_head,
    help="Check against the head that an earlier --verify printed.",
)
@click.option(
    "--anchor",
    "anchors",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Write the newest signed head into the folder DIR; with --verify, check against those in"
    " DIR.",
)
@click.option(
    "--sign", is_flag=True, help="Sign a head over all lines; needs the keys of the permissions CA."
)
@_passphrases.option
@_pager.option
@_settings.command_options
def log(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    since: datetime | None,
    form: str,
    head: str | None,
    anchors: Path | None,
    *,
    passphrase_file: Path | None,
    verify: bool,
    sign: bool,
) -> None:
    """Show or verify the ledger of everything issued, signed and revoked.

    NAME is a participant, a pattern ('/robot1/*') or a group (@hall1), of which only the lines
    are shown. A certificate that was replaced and is still valid is marked as superseded.
    --verify checks the chain of hashes, and that every file in the keystore has an entry.
    Keep the head that it prints in another place: --head then detects a ledger that was
    truncated or rewritten.

    Each command that signs documents signs a head of the tree over all lines. Keep heads where
    users of the keystore cannot change them: --anchor DIR adds the newest one. --verify --anchor
    DIR shows whether the end was cut off, lines were rewritten, or the CAs signed two histories,
    and from which line on.
    """
    _formats.chosen(form)
    verify = verify or head is not None
    if verify or sign or anchors:
        _refuse_parts(names, since, form)
    if sign and verify:
        raise UsageError("--sign excludes --verify and --head")
    keystore = _settings.open_keystore(to_change=sign)
    if verify:
        _verify(keystore, head, anchors)
        return
    if sign:
        _sign(keystore, passphrase_file, quiet=anchors is not None)
    if anchors:
        _anchor(keystore, anchors)
    if not sign and not anchors:
        earlier = superseded_certificates(keystore, now=_settings.now())
        superseded = {each.sha256 for those in earlier.values() for each in those}
        _show(_lines(keystore, names, since), superseded, form)


def _refuse_parts(names: tuple[str, ...], since: datetime | None, form: str) -> None:
    """UsageError if only a part of the ledger is asked for."""
    if names or since or form == _formats.CSV:
        raise UsageError(
            "--verify, --head, --sign and --anchor are for all lines: they exclude NAME, --since"
            " and csv"
        )


def _show(lines: list[Line], superseded: Container[str], form: str) -> None:
    """Print the lines; `superseded` has the SHA-256 of replaced certificates that are valid."""
    values = [{**each.to_json(), "superseded": _is_among(superseded, each)} for each in lines]
    _formats.emit(
        form,
        {"lines": values},
        _printing.table(_HEADERS, (_row(each, superseded) for each in lines)),
        columns=_COLUMNS,
        items=values,
    )


def _lines(keystore: Keystore, names: Iterable[str], since: datetime | None) -> list[Line]:
    """The lines of these participants, or without names all, from `since` on.

    KeystoreError for a name or pattern that is in no line.
    """
    lines = keystore.as_found.lines()
    if names:
        known = dict.fromkeys(each.entry.name for each in lines if each.entry.name.startswith("/"))
        wanted = set(map(regular_name, keystore.named(names, sorted(known))))
        for name in sorted(wanted - known.keys()):
            raise KeystoreError(
                f"the ledger has no participant {name}",
                hint=nearest(name, known) or "`pqsec status` lists the participants",
            )
        lines = [each for each in lines if each.entry.name in wanted]
    return [each for each in lines if since is None or each.entry.made_at >= since]


def _sign(keystore: Keystore, passphrase_file: Path | None, *, quiet: bool) -> None:
    """Sign a head; `quiet` if another result is printed."""
    signed = sign_head(
        keystore, _passphrases.unlock(keystore, passphrase_file, SigningCa.PERMISSIONS)
    )
    if not quiet:
        value = {"origin": signed.origin, "size": signed.size, "root": signed.root.hex()}
        _printing.emit(value, [f"signed: the head of {signed.size} lines"])


def _anchor(keystore: Keystore, folder: Path) -> None:
    done = write_anchor(keystore, folder)
    if done.unsigned:
        newer = _printing.counted(done.unsigned, "newer line")
        _printing.note(f"no signed head is over {newer}: `pqsec log --sign` signs one")
    word = "was already there" if done.already else "written"
    _printing.emit(done.to_json(), [f"{done.path}  the head of {done.head.size} lines, {word}"])


def _verify(keystore: Keystore, head: str | None, anchors: Path | None) -> None:
    try:
        count, newest = audit(keystore, head, anchors)
    except VerificationError as error:
        if _settings.settings().json:
            _printing.emit({"ok": False, "problems": error.lines}, [])
        raise
    older = older_copies(keystore) if keystore.ledger_address else []
    if older:
        _printing.note(
            f"older copies: {_printing.few(list(map(str, older)))}; another machine with this"
            " ledger made newer ones; `pqsec ca recover` gets the governance and the list"
        )
    value: dict[str, object] = {"ok": True, "lines": count, "head": newest, "older": older}
    said = [f"the ledger is complete: {count} lines, head {newest}"]
    if anchors:
        sizes = [each.head.size for each in read_anchors(anchors).values()]
        value |= {"anchors": len(sizes), "anchored": sizes[-1]}
        said.append(f"it has the lines of all heads in {anchors}: {len(sizes)}, up to {sizes[-1]}")
    _printing.emit(value, said)


_JSON_ONLY = {"keys", "mark", "statement"}
"""Details that only --json shows."""


def _is_among(superseded: Container[str], line: Line) -> bool:
    return line.entry.kind == _PARTICIPANT and line.entry.sha256 in superseded


def _row(line: Line, superseded: Container[str]) -> tuple[str, ...]:
    entry = line.entry
    details = [
        f"{key} {_short(v)}" for key, v in entry.details.items() if v and key not in _JSON_ONLY
    ]
    if entry.details.get("mark", "").startswith(PERMITTED):
        details.append("by permit")
    if _is_among(superseded, line):
        details.append(f"superseded, valid until {said(entry.ends)}")
    what = f"{entry.kind} ({', '.join(details)})" if details else entry.kind
    last = entry.serial or entry.sha256[:16]
    return (str(line.number), _when(entry), entry.operator or "-", what, entry.name or "-", last)


def _when(entry: Entry) -> str:
    """The time, for people; for a damaged line, the text that it has."""
    try:
        return said(entry.made_at)
    except KeystoreError:
        return entry.at[:16]


def _short(value: str) -> str:
    """The first 16 digits of a hash, and a time for people; anything else unchanged."""
    if value.endswith("+00:00"):
        with suppress(ValueError):
            return said(datetime.fromisoformat(value))
    return value[:16] if len(value) == _SHA256 else value
