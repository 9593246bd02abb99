"""S/MIME multipart/signed, as pqsec writes it and reads it (RFC 8551 3.5.3).

All stacks call SMIME_read_PKCS7 and PKCS7_verify with PKCS7_TEXT, so the signed part is
text/plain with CRLF line ends. On disk the file has LF, which all of them accept, as
measured.
"""

import base64
import binascii
import hashlib
import re
from collections.abc import Iterator
from itertools import islice, pairwise

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError

MAX_MESSAGE = 8 << 20
"""Bytes. The largest document that any stack was measured to accept is 0.5 MB."""
TEXT_HEADER = b"Content-Type: text/plain\r\n\r\n"
_LINE = 64
_BOUNDARY_END = re.compile(rb"(|--)[ \t]*(?=\r\n|\Z)")
"""What may follow the boundary in its line: nothing, or -- for the last one."""
_BASE64 = re.compile(rb"(?:[A-Za-z0-9+/]{1,76}\r\n)*[A-Za-z0-9+/]{1,76}={0,2}(?:\r\n)*")
"""Lines of base64 that every decoder reads completely (RFC 2045 6.8)."""
_LINE_END = re.compile(rb"(?<!\r)\r*+\n")
"""Matches only at the first CR, so that a million of them are scanned once."""
_MICALG = re.compile(
    rb"MIME-Version: 1\.0\nContent-Type: multipart/signed;"
    rb' protocol="application/x-pkcs7-signature"; micalg="([a-z0-9-]{1,20})"; boundary="'
)
_MARKS = [b"", b"", b"--"]
"""What follows the boundary in its three lines."""
_NOT_BASE64 = "the signature part of the document is not base64"
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
    """A multipart/signed message, parsed by pqsec's own reader."""

    boundary: bytes
    content: bytes
    """The signed part with its MIME header, CRLF line ends: what the signature covers."""
    signature: bytes
    """The text of the second part: base64 of the CMS structure, BER or DER."""
    lines_before: int
    """Number of lines of the file before `content`."""

    @property
    def cms(self) -> bytes:
        """The CMS structure, BER or DER; MalformedError if it is not base64."""
        text = self.signature.replace(b"\r\n", b"")
        # The library ignores excess padding.
        if len(text) % 4 or not _BASE64.fullmatch(self.signature):
            raise MalformedError(_NOT_BASE64)
        try:
            return base64.b64decode(text, validate=True)
        except binascii.Error as error:
            raise MalformedError(_NOT_BASE64) from error

    @property
    def header_and_text(self) -> tuple[bytes, bytes]:
        """The signed part's header and its text; MalformedError unless it is text/plain."""
        header, found, text = self.content.partition(b"\r\n\r\n")
        if not found or not re.search(rb"(?im)^content-type:[ \t]*text/plain\b", header):
            raise MalformedError(
                "the signed part is not text/plain, so no DDS stack would read it",
                hint="sign it with `pqsec`, or with OpenSSL's -text option",
            )
        return header, text


def join(content: bytes, signature: bytes, micalg: str) -> bytes:
    """The file with the DER `signature` over `content`; the same file for the same input.

    A text with the boundary in it would have to contain its own digest.
    """
    before, after = _around_signature(content, micalg)
    text = base64.b64encode(signature)
    lines = b"\n".join(text[start : start + _LINE] for start in range(0, len(text), _LINE))
    return b"".join((before, lines, after))


def is_plain(message: bytes, found: SignedMessage) -> bool:
    """Whether `message`, which has these parts, is framed as `join` does it, without any CR.

    All readers find the same in such a file: its headers are known, and no line in a part begins
    like its boundary.
    """
    kind = _MICALG.match(message)
    if not kind or b"\r" in message or not found.content.startswith(TEXT_HEADER):
        return False
    before, after = _around_signature(found.content, kind[1].decode())
    marks = message.count(b"--" + found.boundary)
    return marks == len(_MARKS) and message.startswith(before) and message.endswith(after)


def _around_signature(content: bytes, micalg: str) -> tuple[bytes, bytes]:
    """The octets before and after the lines of base64."""
    boundary = f"----{hashlib.sha256(content).hexdigest()[:32].upper()}"
    before = (
        _HEADER.format(micalg=micalg, boundary=boundary).encode(),
        content.replace(b"\r\n", b"\n"),
        _SIGNATURE.format(boundary=boundary).encode(),
    )
    return b"".join(before), f"\n\n--{boundary}--\n\n".encode()


def content_of(document: bytes) -> bytes:
    """What a signature over `document` covers: header and text, CRLF line ends.

    A lone CR ends a line too, as in XML 1.0 2.11, because readers differ in how they treat it.
    """
    if b"\r" not in document:  # so with documents that pqsec wrote, and any that peers send
        return TEXT_HEADER + document.replace(b"\n", b"\r\n")
    return TEXT_HEADER + re.sub(rb"\r\n?|\n", b"\r\n", document)


def split(message: bytes) -> SignedMessage:
    """The parts of `message`; MalformedError if it is not one S/MIME multipart/signed."""
    if len(message) > MAX_MESSAGE:
        raise MalformedError(f"larger than {MAX_MESSAGE} bytes, so no signed document")
    if not message:
        raise MalformedError("the file is empty", hint="restore it, or sign the XML again")
    whole = _canonical(message)
    header, found, body = whole.partition(b"\r\n\r\n")
    unfolded = re.sub(rb"\r\n[ \t]+", b" ", header)
    content_type = re.search(rb"(?im)^content-type:[ \t]*multipart/signed\b([^\r]*)", unfolded)
    if not found or not content_type:
        raise MalformedError(
            "not an S/MIME signed document (multipart/signed)",
            hint="sign the XML with `pqsec sign-governance` or `pqsec sign-permissions`",
        )
    boundary = _boundary(content_type[1])
    body = b"\r\n" + body
    first, second = _parts(body, boundary)
    _header, found, signature = body[second].partition(b"\r\n\r\n")
    if not found:
        raise MalformedError("the signature part of the document has no header")
    before = len(header) + len(b"\r\n") + first.start
    return SignedMessage(boundary, body[first], signature, whole.count(b"\n", 0, before))


_SIGNED_HEADER = re.compile(rb"(?im)^content-type:[ \t]*multipart/signed")


def is_signed(data: bytes) -> bool:
    """Whether `data` looks like an S/MIME file."""
    head = data[:4096]
    if b"multipart/signed" not in head.lower():  # as in most files: the search is slow
        return False
    return _SIGNED_HEADER.search(head) is not None


def _canonical(data: bytes) -> bytes:
    """`data` with CRLF line ends; CR CR LF, from text that was converted twice, is one line end."""
    if b"\r" not in data:  # so with files that pqsec or OpenSSL wrote
        return data.replace(b"\n", b"\r\n")
    return _LINE_END.sub(b"\r\n", data)


def _boundary(parameters: bytes) -> bytes:
    found = re.search(rb'(?i);[ \t]*boundary=(?:"([^"\r]{1,70})"|([^";\s]{1,70}))', parameters)
    if not found:
        raise MalformedError("the signed document's MIME header has no boundary")
    return found[1] or found[2]


def _parts(body: bytes, boundary: bytes) -> list[slice]:
    """Positions of the two parts between boundary lines (RFC 2046 5.1.1)."""
    found = _boundary_lines(body, b"\r\n--" + boundary)
    lines = list(islice(found, 4))  # a fourth is one too many
    if [end[1] for _, end in lines] != _MARKS:
        raise MalformedError("a signed document has two parts: the text and its signature")
    return [
        slice(min(end.end() + len(b"\r\n"), start), start)
        for (_, end), (start, _) in pairwise(lines)
    ]


def _boundary_lines(body: bytes, mark: bytes) -> Iterator[tuple[int, re.Match[bytes]]]:
    """Positions of the boundary lines, with what follows the boundary in each."""
    place = body.find(mark)
    while place >= 0:
        after = place + len(mark)
        end = _BOUNDARY_END.match(body, after)
        if end:  # otherwise the line has more text and is not a boundary line
            yield place, end
        place = body.find(mark, after)
