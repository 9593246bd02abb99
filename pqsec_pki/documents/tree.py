"""Any XML as a plain tree, with everything that the values of documents do not contain.

It has order, white space, unknown elements and attributes, each with its line, and
validates none of them. The same safe parser reads it.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import _reading
from pqsec_pki.documents._xml import invalid, parse_any

if TYPE_CHECKING:
    from lxml.etree import _Element

MAX_ELEMENTS = 400_000
"""Elements of a document: each needs memory. A policy of 10,000 rules has 80,000."""

MAX_ATTRIBUTES = 100
"""Attributes of one element. The time of lxml is quadratic in their number."""

_WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")
_MARKS = (b"\xef\xbb\xbf", *_WIDE_MARKS)


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """An element. A tag in a namespace is written {namespace}tag."""

    tag: str
    line: int
    text: str
    """Its text outside its children, with white space, without comments."""
    attributes: tuple[tuple[str, str], ...]
    children: "tuple[Node, ...]"

    def walk(self) -> "Iterator[Node]":
        """This element and all elements in it, in document order."""
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
        """Its text without surrounding white space."""
        return self.text.strip(" \t\r\n")


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """A whole document."""

    root: Node
    encoding: str
    """The declared encoding, or that of the byte order mark; in upper case."""
    byte_order_mark: bool


def read_tree(xml: bytes) -> Tree:
    """The whole content of `xml`.

    InvalidDocumentError as for other documents, for more than MAX_ELEMENTS elements, and for an
    element with more than MAX_ATTRIBUTES attributes.
    """
    root = parse_any(xml)[0]
    if sum(1 for _ in root.iter()) > MAX_ELEMENTS:
        raise invalid(f"more than {MAX_ELEMENTS} elements, so not a document of this kind")
    return Tree(
        root=_node(root),
        encoding=_encoding(xml, root),
        byte_order_mark=xml.startswith(_MARKS),
    )


def _encoding(xml: bytes, root: "_Element") -> str:
    """The declared encoding, or that of the byte order mark, which lxml does not report."""
    if xml.startswith(_WIDE_MARKS):
        return "UTF-16"
    return (root.getroottree().docinfo.encoding or "UTF-8").upper()


def _node(element: "_Element") -> Node:
    if len(element.attrib) > MAX_ATTRIBUTES:
        raise invalid(f"an element has more than {MAX_ATTRIBUTES} attributes")
    # The parser limits the depth to 256.
    return Node(
        tag=element.tag,
        line=_reading.line(element) or 0,
        text="".join((element.text or "", *(child.tail or "" for child in element))),
        attributes=tuple((str(name), str(value)) for name, value in element.attrib.items()),
        children=tuple(map(_node, element)),
    )
