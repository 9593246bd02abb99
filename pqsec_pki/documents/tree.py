"""Any XML as a plain tree: for those who must see what values cannot hold.

Order, white space, comments, unknown elements and attributes are all here, each with its
line, and nothing of them is judged. It is made by the same careful parser as all else.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pqsec_pki.documents import _reading
from pqsec_pki.documents._xml import parse
from pqsec_pki.errors import MalformedError

if TYPE_CHECKING:
    from lxml.etree import _Element

MAX_ELEMENTS = 400_000
"""A policy of 10,000 rules has 80,000; each costs memory here."""

MAX_ATTRIBUTES = 100
"""Of one element. lxml takes a time that grows with their square."""

_WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")
_MARKS = (b"\xef\xbb\xbf", *_WIDE_MARKS)


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """An element. A tag in a namespace is written {namespace}tag."""

    tag: str
    line: int
    text: str
    """What stands in it outside its children, comments left out, spaces and all."""
    attributes: tuple[tuple[str, str], ...]
    children: "tuple[Node, ...]"

    def walk(self) -> "Iterator[Node]":
        """This element and all in it, in document order."""
        yield self
        for child in self.children:
            yield from child.walk()

    def child(self, tag: str) -> "Node | None":
        """The first child with that tag."""
        return next(self.all(tag), None)

    def all(self, *tags: str) -> "Iterator[Node]":
        """The children with one of these tags."""
        return (child for child in self.children if child.tag in tags)

    @property
    def value(self) -> str:
        """Its text without the spaces around it."""
        return self.text.strip(" \t\r\n")


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment, and where it stands."""

    line: int
    inside: str
    """The tag of the element around it."""
    after: str | None
    """The tag of the element before it, if there is one in the same element."""
    is_last: bool
    """Whether no element follows in the same element."""


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """A whole document."""

    root: Node
    comments: tuple[Comment, ...]
    """Those inside the root element; of the others no stack takes notice."""
    encoding: str
    """As declared, or as the byte order mark says; in upper case."""
    byte_order_mark: bool


def read_tree(xml: bytes) -> Tree:
    """All that is in `xml`.

    MalformedError as when a document is read, for more than MAX_ELEMENTS elements, and for
    one with more than MAX_ATTRIBUTES attributes.
    """
    root = parse(xml)
    if sum(1 for _ in root.iter()) > MAX_ELEMENTS:
        raise MalformedError(f"more than {MAX_ELEMENTS} elements, so not a document of this kind")
    return Tree(
        root=_node(root),
        comments=tuple(_comments(xml)),
        encoding=_encoding(xml, root),
        byte_order_mark=xml.startswith(_MARKS),
    )


def _encoding(xml: bytes, root: "_Element") -> str:
    """As declared; lxml does not tell the one that a byte order mark stands for."""
    if xml.startswith(_WIDE_MARKS):
        return "UTF-16"
    return (root.getroottree().docinfo.encoding or "UTF-8").upper()


def _node(element: "_Element") -> Node:
    if len(element.attrib) > MAX_ATTRIBUTES:
        raise MalformedError(f"an element has more than {MAX_ATTRIBUTES} attributes")
    # No deeper than the parser lets pass: 256.
    return Node(
        tag=element.tag,
        line=_reading.line(element) or 0,
        text="".join((element.text or "", *(child.tail or "" for child in element))),
        attributes=tuple((str(name), str(value)) for name, value in element.attrib.items()),
        children=tuple(map(_node, element)),
    )


def _comments(xml: bytes) -> Iterator[Comment]:
    """Those in a document that was read before, and so is safe to read again."""
    from lxml import etree  # noqa: PLC0415 - `pqsec --help` must not load lxml

    if b"<!--" not in xml.replace(b"\0", b""):  # UTF-16 has them between
        return
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_pis=True)
    last: dict[_Element, str] = {}  # parent -> the element seen last in it
    waiting: dict[_Element, list[Comment]] = {}  # those no element has followed yet
    for count, node in enumerate(etree.fromstring(xml, parser).iterdescendants()):
        if count > MAX_ELEMENTS:
            raise MalformedError(f"more than {MAX_ELEMENTS} elements and comments")
        parent = node.getparent()
        if parent is None:  # only the root has none
            continue
        if isinstance(node.tag, str):
            yield from waiting.pop(parent, ())
            last[parent] = node.tag
            continue
        comment = Comment(
            line=_reading.line(node) or 0,
            inside=parent.tag,
            after=last.get(parent),
            is_last=False,
        )
        waiting.setdefault(parent, []).append(comment)
    for rest in waiting.values():
        yield from (replace(comment, is_last=True) for comment in rest)
