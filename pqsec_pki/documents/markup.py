"""The markup of a document as its octets have it, before a parser makes a tree of it.

Parsers differ in what they can read. What one cannot read, such as a space in an end tag, is not
in the tree of another. The document is well-formed: that was checked before.
"""

import re
from collections.abc import Iterator
from enum import Enum, auto

from pqsec_pki._dataclass import dataclass

_TOKEN = re.compile(
    rb"(?P<COMMENT><!--.*?-->)|(?P<INSTRUCTION><\?.*?\?>)|(?P<CDATA><!\[CDATA\[.*?\]\]>)"
    rb"|(?P<END></[^>]*>)|(?P<EMPTY><(?:[^<>\"'/]|\"[^\"]*\"|'[^']*'|/(?!>))*/>)"
    rb"|(?P<START><(?:[^<>\"'/]|\"[^\"]*\"|'[^']*'|/(?!>))*>)|(?P<TEXT>[^<]+)",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(rb"([^\s=\"'<>/]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_DECLARATION = re.compile(rb"<\?xml\s")


class TokenKind(Enum):
    """What a token is."""

    COMMENT = auto()
    INSTRUCTION = auto()
    """A processing instruction; the XML declaration is not one."""
    CDATA = auto()
    START = auto()
    EMPTY = auto()
    """The tag of an empty element, such as <partition/>."""
    END = auto()
    TEXT = auto()


@dataclass(frozen=True, slots=True, eq=False)
class Token:
    """A tag, a comment, a text without tags, and so on."""

    kind: TokenKind
    octets: bytes
    begin: int
    """Where it begins in the document, in octets."""
    line: int

    @property
    def end(self) -> int:
        """Where it ends in the document."""
        return self.begin + len(self.octets)

    @property
    def name(self) -> str:
        """The name in a tag, with its prefix as it is written."""
        return re.split(rb"[\s/>]", self.octets.lstrip(b"</"), maxsplit=1)[0].decode()

    @property
    def attributes(self) -> tuple[tuple[str, bytes], ...]:
        """(name as it is written, value as it is written) of a tag; also declared namespaces."""
        found = _ATTRIBUTE.findall(self.octets)
        return tuple((name.decode(), value[1:-1]) for name, value in found)


def tokens_of(xml: bytes) -> Iterator[Token]:
    """The tokens of a well-formed document without DOCTYPE, in their order, without declaration.

    None of a document in UTF-16, whose octets are not those of ASCII.
    """
    if b"\0" in xml:
        return
    line, counted = 1, 0
    for found in _TOKEN.finditer(xml):
        line += xml.count(b"\n", counted, found.start())
        counted = found.start()
        if not (found.lastgroup == "INSTRUCTION" and _DECLARATION.match(found[0])):
            kind = TokenKind[str(found.lastgroup)]
            yield Token(kind=kind, octets=found[0], begin=found.start(), line=line)
