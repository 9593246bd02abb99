"""A model of OpenSSL's readers of signed files: SMIME_read_PKCS7, SMIME_read_CMS, SMIME_text.

Every DDS stack uses them, and they read some files differently from RFC 2045 and 2046. So
pqsec accepts a signed file only if this model finds the same content as its own reader.
Checked against OpenSSL 3.0 and 3.5 by tests/fuzz/differential.py.
"""

import itertools
import re
from dataclasses import field

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError

_LONGEST = 1023
"""Bytes that OpenSSL reads at once; the rest of a longer line counts as another line."""
_CHUNK = re.compile(rb"[^\n]{0,%d}+\n|[^\n]{1,%d}" % (_LONGEST - 1, _LONGEST))
_MAX_HEADER = 1 << 16
"""Bytes. Headers are read octet by octet; those of real files have about 200 bytes."""
_SPACE = b" \t\n\v\f\r"
_SPACES = {bytes([octet]) for octet in _SPACE}
_MARKS = re.compile(rb'[:;="()]')
_LINE_END = re.compile(rb"[\r\n]")
_SIGNED = b"multipart/signed"
_SIGNATURES = {b"application/x-pkcs7-signature", b"application/pkcs7-signature"}
_TEXT = b"text/plain"


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of a signed file as OpenSSL reads them."""

    boundary: bytes
    content: bytes
    """The signed part with its MIME header, CRLF line ends."""
    signature: bytes
    """The text after the header of the second part: base64."""


@dataclass(slots=True)
class _Header:
    name: bytes | None
    value: bytes | None
    parameters: list[tuple[bytes | None, bytes | None]] = field(default_factory=list)


def read(message: bytes) -> Parts:
    """The parts of `message` as OpenSSL reads them; MalformedError, with the reason, if not."""
    header, body = _content_type(message, "the file")
    if header.value != _SIGNED:
        raise MalformedError(f"it takes the file for {_shown(header.value)}")
    boundary = _boundary(header)
    parts = _split(body, boundary)
    if len(parts) != 2:  # noqa: PLR2004 -- the text and its signature
        raise MalformedError(f"it finds {len(parts)} parts in it, not two")
    kind, signature = _content_type(parts[1], "the signature")
    if kind.value not in _SIGNATURES:
        raise MalformedError(f"it takes the signature for {_shown(kind.value)}")
    return Parts(boundary, parts[0], signature)


def text(content: bytes) -> bytes:
    """The document in a signed part; MalformedError if OpenSSL does not accept it as text."""
    header, document = _content_type(content, "the signed part")
    if header.value != _TEXT:
        raise MalformedError(f"it takes the signed part for {_shown(header.value)}")
    return document


def _content_type(data: bytes, what: str) -> tuple[_Header, bytes]:
    """The content-type header of `data`, and what follows all headers."""
    headers, body = _headers(data)
    found = [each for each in headers if each.name == b"content-type"]
    if not found or found[0].value is None:
        raise MalformedError(f"it finds no content type of {what}")
    if len(found) > 1:  # OpenSSL sorts by name, so it may find any of them
        raise MalformedError(f"it finds {len(found)} content types of {what}")
    return found[0], body


def _boundary(header: _Header) -> bytes:
    found = [value for name, value in header.parameters if name == b"boundary"]
    if not found or found[0] is None:
        raise MalformedError("it finds no boundary")
    if len(found) > 1:
        raise MalformedError(f"it finds {len(found)} boundaries")
    return found[0]


def _split(body: bytes, boundary: bytes) -> list[bytes]:
    """The parts. A line that begins with the boundary is a boundary line, whatever follows."""
    chunks: list[bytes] = _CHUNK.findall(body)
    mark = b"--" + boundary
    marks = [place for place, chunk in enumerate(chunks) if chunk.startswith(mark)]
    ends = (place for place in marks if chunks[place].startswith(b"--", len(mark)))
    end = next(ends, None)
    if end is None:
        raise MalformedError("it finds no end of the last part")
    starts = [place for place in marks if place <= end]
    spans = [chunks[a + 1 : b] for a, b in itertools.pairwise(starts)]
    return [_joined(span) for span in spans if span]


def _joined(chunks: list[bytes]) -> bytes:
    """The lines of a part, without CR at line ends and with CRLF between lines."""
    lines = [
        chunk.rstrip(b"\r\n") + (b"\r\n" if chunk.endswith(b"\n") else b"") for chunk in chunks
    ]
    return b"".join(lines).removesuffix(b"\r\n") if chunks[-1].endswith(b"\n") else b"".join(lines)


def _headers(data: bytes) -> tuple[list[_Header], bytes]:
    """The header lines up to the first blank one, and what follows it."""
    headers: list[_Header] = []
    for found in _CHUNK.finditer(data, 0, _MAX_HEADER):
        line = found[0]
        _read_line(line, headers)
        if line[:1] in {b"\r", b"\n"}:
            return headers, data[found.end() :]
    if len(data) > _MAX_HEADER:
        raise MalformedError(f"a header is longer than {_MAX_HEADER} bytes")
    return headers, b""


def _read_line(line: bytes, headers: list[_Header]) -> None:
    """Parse one header line into `headers`: a new header, or parameters of the last one."""
    reader = _LineReader(line, headers)
    reader.state = "name" if headers and line[:1] in _SPACES else "start"
    for found in _MARKS.finditer(line, 0, _line_end(line)):
        reader.take(found.start(), found[0])
    reader.end()


def _line_end(line: bytes) -> int:
    found = _LINE_END.search(line)
    return found.start() if found else len(line)


class _LineReader:
    """Parses a header line, mark by mark; its state is reset at the end of a line."""

    def __init__(self, line: bytes, headers: list[_Header]) -> None:
        self._line, self._headers = line, headers
        self.state = "start"
        self._before_comment = ""
        self._start = 0
        self._name: bytes | None = None

    def take(self, place: int, octet: bytes) -> None:
        """Process a mark; all other octets of a line leave the state as it is."""
        match self.state, octet:
            case "start", b":":
                self._name = self._piece(place)
                self.state = "type"
            case "type", b";":
                self._headers.append(_Header(_lower(self._name), _lower(self._piece(place))))
                self.state = "name"
            case "name", b"=":
                self._name = self._piece(place)
                self.state = "value"
            case "value", b";":
                self._add(self._piece(place))
                self.state = "name"
            case "value", b'"':
                self.state = "quote"
            case "quote", b'"':
                self.state = "value"
            case (("type" | "value"), b"("):
                self._before_comment, self.state = self.state, "comment"
            case "comment", b")":
                self.state = self._before_comment

    def end(self) -> None:
        """End the line: this completes the current value, unless within a quote or comment."""
        rest = _stripped(self._line[self._start :])
        if self.state == "type":
            self._headers.append(_Header(_lower(self._name), _lower(rest)))
        elif self.state == "value":
            self._add(rest)

    def _piece(self, place: int) -> bytes | None:
        piece = _stripped(self._line[self._start : place])
        self._start = place + 1
        return piece

    def _add(self, value: bytes | None) -> None:
        self._headers[-1].parameters.append((_lower(self._name), value))


def _stripped(piece: bytes) -> bytes | None:
    """`piece` without surrounding space, and without a quote at either end."""
    begun = piece.lstrip(_SPACE)
    begun = begun.removeprefix(b'"')
    ended = begun.rstrip(_SPACE)
    if not ended:
        return None
    if not ended.endswith(b'"'):
        return ended
    return None if len(ended) == 2 else ended[:-1]  # noqa: PLR2004 -- as in OpenSSL, X" gives nothing


def _lower(piece: bytes | None) -> bytes | None:
    return None if piece is None else piece.lower()


def _shown(value: bytes | None) -> str:
    return repr((value or b"")[:40].decode("ascii", "backslashreplace"))
