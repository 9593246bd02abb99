"""Read a signed file, and refuse it if readers could find different documents in it.

Different readers could find different documents, each validly signed. So pqsec accepts a
file only if its own reader and the model of OpenSSL's reader find the same.
"""

import re
from collections.abc import Callable
from typing import TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError
from pqsec_pki.smime import _mime, _openssl_reader

Found = TypeVar("Found")
_DECLARED = re.compile(rb"<\?xml[^>]{1,200}?encoding\s*=\s*[\"']([A-Za-z][\w.-]{0,40})[\"']")
_UTF8 = re.compile(rb"(?i)utf-?8|(?:us-)?ascii")
_WITH_ASCII = re.compile(
    rb"(?i)iso-8859-[0-9]{1,2}|windows-125[0-9]|koi8-[ru]|euc-(?:jp|kr)|gb(?:2312|k|18030)|big5"
)
"""Codes in which octets of ASCII are the letters of ASCII."""


class AmbiguousError(MalformedError):
    """A signed file in which OpenSSL, so every DDS stack, finds another document, or none."""

    def __init__(self, why: str) -> None:
        super().__init__(
            f"DDS stacks would not read the same document in it: {why}",
            hint="ask the signer for the document, and sign it again",
        )


@dataclass(frozen=True, slots=True)
class ParsedMessage:
    """The content of a signed file, the same for all readers."""

    content: bytes
    """The signed part with its MIME header, CRLF line ends: what the signature covers."""
    cms: bytes
    """The CMS structure, BER or DER."""
    _message: _mime.SignedMessage
    is_plain: bool = False
    """Whether it has the form in which all readers find the same."""

    @property
    def document(self) -> bytes:
        """The document. MalformedError unless it is text/plain; AmbiguousError as in read()."""
        _, text = self._message.header_and_text
        if not self.is_plain and _of_openssl(_openssl_reader.text, self.content) != text:
            raise AmbiguousError("OpenSSL ends the header of the signed part elsewhere")
        if code := _other_code(text):
            raise AmbiguousError(f"it is in {code}, and stacks read its octets as UTF-8")
        return text

    @property
    def lines_before(self) -> int:
        """Number of lines of the file before the document."""
        header, _ = self._message.header_and_text
        return self._message.lines_before + header.count(b"\n") + 2


def read(message: bytes) -> ParsedMessage:
    """The content of the S/MIME file `message`.

    MalformedError if it is not one multipart/signed; AmbiguousError if OpenSSL finds other
    parts in it than RFC 2046 does.
    """
    own = _mime.split(message)
    if b"\0" in message:
        raise AmbiguousError("it has a NUL, where some stacks stop reading")
    if _mime.is_plain(message, own):
        return ParsedMessage(own.content, own.cms, own, is_plain=True)
    other = _of_openssl(_openssl_reader.read, message)
    if other.content != own.content or other.signature.rstrip() != own.signature.rstrip():
        raise AmbiguousError(_difference(own, other))
    return ParsedMessage(own.content, own.cms, own)


def _other_code(xml: bytes) -> str | None:
    """The code that an XML declaration names, if the octets are other letters in it than in UTF-8.

    DDS stacks do not look at the declaration: what is signed would say something else to them.
    """
    found = _DECLARED.match(xml)
    if found is None or _UTF8.fullmatch(found[1]):
        return None
    same = xml.isascii() and _WITH_ASCII.fullmatch(found[1])
    return None if same else found[1].decode()


def _of_openssl(reader: Callable[[bytes], Found], data: bytes) -> Found:
    try:
        return reader(data)
    except MalformedError as error:
        raise AmbiguousError(f"OpenSSL refuses it, because {error}") from None


def _difference(own: _mime.SignedMessage, other: _openssl_reader.Parts) -> str:
    if own.boundary != other.boundary:
        return f"OpenSSL reads the boundary {other.boundary[:70]!r}, not {own.boundary!r}"
    part = "text" if own.content != other.content else "signature"
    return f"OpenSSL finds another {part} between the boundary lines"
