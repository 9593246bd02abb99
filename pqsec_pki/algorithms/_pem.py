"""PEM: DER between two lines that say what it is (RFC 7468)."""

import base64
import binascii
import re
import string

from pqsec_pki.errors import MalformedError

_PEM = re.compile(rb"-----BEGIN ([A-Z0-9 ]+)-----[ \t]*\r?\n([^-]*)-----END \1-----")
"""The text has no hyphen, so that a block without an end costs no more than its length."""
_SPACE = string.whitespace.encode()


def pem(label: str, der: bytes) -> bytes:
    """`der` as PEM with lines of 64 characters (RFC 7468)."""
    text = base64.b64encode(der)
    lines = [text[start : start + 64] for start in range(0, len(text), 64)]
    return b"\n".join(
        [f"-----BEGIN {label}-----".encode(), *lines, f"-----END {label}-----".encode(), b""]
    )


def unpem(data: bytes, what: str) -> list[tuple[str, bytes]]:
    """(label, DER) of each PEM block in `data`; MalformedError if a block is broken."""
    try:
        return [
            (label.decode(), base64.b64decode(body.translate(None, _SPACE), validate=True))
            for label, body in _PEM.findall(data)
            if b":" not in body  # RFC 1421 headers: a traditional encrypted key
        ]
    except binascii.Error as error:
        raise MalformedError(f"{what}: broken base64 in PEM") from error


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
