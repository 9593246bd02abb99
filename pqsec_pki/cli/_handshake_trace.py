"""verify-handshake --trace: write every byte of a handshake to a file or stdout."""

from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._files import refuse_existing, write
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.errors import PqsecError
from pqsec_pki.inspection import describe
from pqsec_pki.selfcheck import HandshakeReport
from pqsec_pki.selfcheck.trace import DecodedMessage, Piece, Trace, trace

STDOUT = Path("-")
_LINE = 32
"""Bytes in a line of hex."""
_HIDDEN = "(withheld: --insecure-show-secrets shows it)"


def refuse_existing_file(path: Path) -> None:
    """ExistsError if the file exists. Called before the handshake runs."""
    if path != STDOUT:
        refuse_existing(path)


def write_trace(
    report: HandshakeReport, summary: list[str], path: Path, *, show_secrets: bool, force: bool
) -> None:
    """Write the trace of `report` to `path` or stdout; `summary` has the lines of the report.

    ExistsError if the file exists, unless `force`.
    """
    found = trace(report, _described)
    value = found.to_json(show_secrets=show_secrets)
    lines = [*summary, "", *_lines(found, show_secrets=show_secrets)]
    if path == STDOUT:
        _printing.emit(value, lines)
        return
    text = _printing.as_json(value) if _settings.settings().json else "\n".join(lines)
    write(path, text.encode() + b"\n", private=show_secrets, force=force)
    _printing.emit(report.to_json(), summary)


def _described(data: bytes) -> list[str]:
    try:
        return describe(data, now=_settings.now()).to_text()
    except PqsecError as error:
        return [f"unreadable: {error}"]


def _lines(found: Trace, *, show_secrets: bool) -> Iterator[str]:
    for number, message in enumerate(found.messages, 1):
        yield from _message(number, message)
    if found.derived:
        yield "== derived by both sides"
        for piece in found.derived:
            yield from _piece(piece, show=show_secrets or not piece.secret)


def _message(number: int, message: DecodedMessage) -> Iterator[str]:
    way = f"{message.sender} to {message.receiver}"
    yield f"== {number}. {message.name}, {way}, {len(message.sample)} bytes"
    for name, words in message.header.items():
        yield f"{name.replace('_', ' ')}: {words}"
    for piece in message.pieces:
        yield from _piece(piece)
    yield "the whole:"
    yield from _hex(message.sample)
    yield ""


def _piece(piece: Piece, indent: str = "", *, show: bool = True) -> Iterator[str]:
    yield f"{indent}{piece.name}: {len(piece.data)} bytes"
    yield from (f"{indent}  | {words}" for words in piece.words)
    if not show:
        yield f"{indent}    {_HIDDEN}"
    elif piece.parts:
        for part in piece.parts:
            yield from _piece(part, f"{indent}    ")
    else:
        yield from (f"{indent}{line}" for line in _hex(piece.data))


def _hex(data: bytes) -> Iterator[str]:
    for start in range(0, len(data), _LINE):
        yield f"    {data[start : start + _LINE].hex()}"
