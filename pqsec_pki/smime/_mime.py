"""S/MIME multipart/signed, as DDS stacks read it (RFC 8551 3.5.3).

All stacks call SMIME_read_PKCS7 and PKCS7_verify with PKCS7_TEXT, so the signed part is
text/plain with CRLF line ends; on disk the file has LF, which all of them were measured
to take.
"""

import base64
import binascii
import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, pairwise

from pqsec_pki.errors import MalformedError

MAX_MESSAGE = 8 << 20
"""Bytes. The largest document any stack was measured to take is 0.5 MB."""
TEXT_HEADER = b"Content-Type: text/plain\r\n\r\n"
_LINE = 64
_BOUNDARY_END = re.compile(rb"(|--)[ \t]*(?=\r\n|\Z)")
"""What may follow the boundary in its line: nothing, or that it is the last."""
_HEADER = """\
MIME-Version: 1.0
Content-Type: multipart/signed; protocol="application/x-pkcs7-signature"; \
micalg="{micalg}"; boundary="{boundary}"

This is an S/MIME signed message

--{boundary}
"""
_SIGNATURE = """
--{boundary}
Content-Type: application/x-pkcs7-signature; name="smime.p7s"
Content-Transfer-Encoding: base64
Content-Disposition: attachment; filename="smime.p7s"

"""


@dataclass(frozen=True, slots=True)
class SignedMessage:
    """A multipart/signed message taken apart."""

    content: bytes
    """The signed part with its MIME header, CRLF line ends: what the signature covers."""
    signature: bytes
    """The CMS structure, BER or DER."""

    @property
    def document(self) -> bytes:
        """The signed part without its header; MalformedError unless it is text/plain."""
        header, found, body = self.content.partition(b"\r\n\r\n")
        if not found or not re.search(rb"(?im)^content-type:[ \t]*text/plain\b", header):
            raise MalformedError(
                "the signed part is not text/plain, so no DDS stack would read it",
                hint="sign it with `pqsec`, or with OpenSSL's -text option",
            )
        return body


def join(document: bytes, signature: bytes, micalg: str) -> bytes:
    """The file of `document` and the DER `signature` over content_of(document)."""
    boundary = f"----{secrets.token_hex(16).upper()}"
    text = base64.b64encode(signature)
    lines = b"\n".join(text[start : start + _LINE] for start in range(0, len(text), _LINE))
    return b"".join(
        (
            _HEADER.format(micalg=micalg, boundary=boundary).encode(),
            content_of(document).replace(b"\r\n", b"\n"),
            _SIGNATURE.format(boundary=boundary).encode(),
            lines,
            f"\n\n--{boundary}--\n\n".encode(),
        )
    )


def content_of(document: bytes) -> bytes:
    """What a signature over `document` covers: header and text, CRLF line ends.

    A lone CR ends a line too, as in XML 1.0 2.11: no reader agrees with another on it.
    """
    return TEXT_HEADER + re.sub(rb"\r\n?|\n", b"\r\n", document)


def split(message: bytes) -> SignedMessage:
    """`message` taken apart; MalformedError if it is not one S/MIME multipart/signed."""
    if len(message) > MAX_MESSAGE:
        raise MalformedError(f"larger than {MAX_MESSAGE} bytes, so no signed document")
    header, found, rest = _canonical(message).partition(b"\r\n\r\n")
    unfolded = re.sub(rb"\r\n[ \t]+", b" ", header)
    content_type = re.search(rb"(?im)^content-type:[ \t]*multipart/signed\b([^\r]*)", unfolded)
    if not found or not content_type:
        raise MalformedError(
            "not an S/MIME signed document (multipart/signed)",
            hint="sign the XML with `pqsec sign-governance` or `pqsec sign-permissions`",
        )
    parts = _parts(rest, _boundary(content_type[1]))
    return SignedMessage(parts[0], _decoded(parts[1]))


def is_signed(data: bytes) -> bool:
    """Whether `data` looks like an S/MIME file."""
    return re.search(rb"(?im)^content-type:[ \t]*multipart/signed", data[:4096]) is not None


def _canonical(data: bytes) -> bytes:
    return data.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n")


def _boundary(parameters: bytes) -> bytes:
    found = re.search(rb'(?i);[ \t]*boundary=(?:"([^"\r]{1,70})"|([^";\s]{1,70}))', parameters)
    if not found:
        raise MalformedError("the signed document's MIME header has no boundary")
    return found[1] or found[2]


def _parts(body: bytes, boundary: bytes) -> list[bytes]:
    """The two parts between boundary lines (RFC 2046 5.1.1)."""
    body = b"\r\n" + body
    found = _boundary_lines(body, b"\r\n--" + boundary)
    lines = list(islice(found, 4))  # a fourth is one too many
    if [end[1] for _, end in lines] != [b"", b"", b"--"]:
        raise MalformedError("a signed document has two parts: the text and its signature")
    return [
        body[end.end() : start].removeprefix(b"\r\n") for (_, end), (start, _) in pairwise(lines)
    ]


def _boundary_lines(body: bytes, mark: bytes) -> Iterator[tuple[int, re.Match[bytes]]]:
    """Where each begins, and what follows the boundary in it."""
    place = body.find(mark)
    while place >= 0:
        after = place + len(mark)
        end = _BOUNDARY_END.match(body, after)
        if end:  # else the line goes on, and is none
            yield place, end
        place = body.find(mark, after)


def _decoded(part: bytes) -> bytes:
    _header, found, body = part.partition(b"\r\n\r\n")
    if not found:
        raise MalformedError("the signature part of the document has no header")
    try:
        return base64.b64decode(b"".join(body.split()), validate=True)
    except binascii.Error as error:
        raise MalformedError("the signature part of the document is not base64") from error
