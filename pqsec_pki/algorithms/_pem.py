"""PEM: DER between two label lines (RFC 7468), accepted only if all readers agree.

Text may stand before, between and after the blocks (section 2). Anything else that OpenSSL
or another lax reader could read as the start or end of a block is refused, and so is a block
that they would split differently: so all readers find the same.
"""

import base64
import binascii
import re

from pqsec_pki.errors import MalformedError

_LINE = 64
"""Characters of a line (RFC 7468, section 2)."""
_MARKS = (b"-----BEGIN", b"-----END")
_LINE_END = rb"[ \t]*\r?\n"
_BLOCK = re.compile(
    rb"^-----BEGIN (?P<label>[A-Z0-9]+(?: [A-Z0-9]+)*)-----" + _LINE_END +
    rb"(?P<header>(?:[A-Za-z-]+:[^\n]*\n(?:[ \t]+[^\s-][^\n]*\n)*)+" + _LINE_END + rb")?"
    rb"(?P<text>(?:[A-Za-z0-9+/]+" + _LINE_END + rb")*[A-Za-z0-9+/]+={0,2}" + _LINE_END + rb")"
    rb"-----END (?P=label)-----(?:" + _LINE_END + rb"|[ \t]*\Z)",
    re.MULTILINE,
)  # fmt: skip
"""No part of it matches a hyphen at the start of a line, so the time is linear."""
_NOT_FOR_ALL = {"X509 CERTIFICATE", "TRUSTED CERTIFICATE"}
"""Labels that OpenSSL accepts as CERTIFICATE, and few other readers do."""


def pem(label: str, der: bytes) -> bytes:
    """`der` as PEM with lines of 64 characters (RFC 7468)."""
    text = base64.b64encode(der)
    lines = [text[start : start + _LINE] for start in range(0, len(text), _LINE)]
    return b"\n".join(
        [f"-----BEGIN {label}-----".encode(), *lines, f"-----END {label}-----".encode(), b""]
    )


def exact_der(label: str, data: bytes) -> bytes | None:
    """The DER of which `data` is exactly `pem(label, DER)`; None for other data, also other PEM.

    Each message of a peer has such PEM, which is read in a third of the time here.
    """
    begin, end = f"-----BEGIN {label}-----\n".encode(), f"\n-----END {label}-----\n".encode()
    if not (data.startswith(begin) and data.endswith(end)):
        return None
    body = data[len(begin) : -len(end)]
    text = body.replace(b"\n", b"")
    ends = (len(text) - 1) // _LINE
    if body[_LINE :: _LINE + 1] != b"\n" * ends or len(body) != len(text) + ends:
        return None
    try:
        der = binascii.a2b_base64(text, strict_mode=True)
    except binascii.Error:
        return None
    # Only the unused bits of the last characters are left to check.
    last = der[-(len(der) % 3 or 3) :]
    return der if binascii.b2a_base64(last, newline=False) == text[-4:] else None


def unpem(data: bytes, what: str) -> list[tuple[str, bytes]]:
    """(label, DER) of each PEM block in `data`; MalformedError, naming `what`, if one is broken.

    Traditional encrypted keys, the only blocks that may have headers (RFC 1421), are left out.
    """
    if (der := exact_der("CERTIFICATE", data)) is not None:  # as in nearly all files
        return [("CERTIFICATE", der)]
    found = []
    for block in blocks(data, what):
        label, text = block["label"].decode(), block["text"]
        if not block["header"]:
            found.append((label, _decoded(text, what)))
        elif not label.endswith(" PRIVATE KEY") or label == "ENCRYPTED PRIVATE KEY":
            raise MalformedError(f"{what}: a header in PEM, for traditional private keys only")
        if label in _NOT_FOR_ALL:
            raise MalformedError(f"{what}: PEM says {label}, where some readers want CERTIFICATE")
    return found


def blocks(data: bytes, what: str) -> list[re.Match[bytes]]:
    """The PEM blocks in `data`: label, header, text; MalformedError, naming `what`, as unpem()."""
    found = list(_BLOCK.finditer(data))
    marks = sum(data.count(mark) for mark in _MARKS)
    if marks != len(_MARKS) * len(found):
        raise MalformedError(
            f"{what}: broken PEM, in which other readers could find something else",
            hint="write each BEGIN and END on its own line, and only base64 between them",
        )
    if found and b"\0" in data:
        raise MalformedError(f"{what}: a NUL in PEM")
    return found


def first_pem(data: bytes, labels: set[str], what: str, *, limit: int) -> bytes:
    """The DER of the first block in `data` with one of `labels`.

    MalformedError, naming `what`, if there is none or `data` is over `limit` bytes.
    """
    if len(data) > limit:
        raise MalformedError(f"a {what} larger than {limit} bytes")
    for label, der in unpem(data, what):
        if label in labels:
            return der
    raise MalformedError(f"no {what} in PEM")


def _decoded(text: bytes, what: str) -> bytes:
    whole = b"".join(text.split())
    if len(whole) % 4:  # the library ignores excess padding
        raise MalformedError(f"{what}: broken base64 in PEM")
    try:
        return base64.b64decode(whole, validate=True)
    except binascii.Error as error:
        raise MalformedError(f"{what}: broken base64 in PEM") from error
