"""The only place that parses XML from outside.

It fetches nothing, replaces no entity and refuses a DOCTYPE: neither document needs them, and
each has been used for attacks. Parsing ends for any input: there is a limit on size here, and
one on depth in libxml2.
"""

from collections.abc import Iterator
from functools import cache
from itertools import islice
from typing import TYPE_CHECKING

from pqsec_pki.errors import InvalidDocumentError, library_call, shown, words_of
from pqsec_pki.problems import Code, Problem

if TYPE_CHECKING:
    from lxml.etree import XMLParser, _Element

MAX_DOCUMENT = 8 << 20
"""Bytes. The largest document that any stack accepted when measured is 0.5 MB."""

MAX_PROBLEMS = 100
"""More do not help a reader, and a hostile document has a million."""

XSI = "{http://www.w3.org/2001/XMLSchema-instance}"
"""The namespace whose attributes an XML schema allows on every element (XML Schema 1, 2.6)."""
XSI_LOCATIONS = frozenset({f"{XSI}schemaLocation", f"{XSI}noNamespaceSchemaLocation"})
"""Hints where a schema may be, for editors. Nothing here follows them."""

_MARKUP = {"Comment": "a comment", "ProcessingInstruction": "a processing instruction"}
_CDATA = "<![CDATA["


def parse(xml: bytes) -> "_Element":
    """The root element of `xml`, without its comments and processing instructions.

    Errors as in `parse_any`, and if there is markup in a value.
    """
    root, markup = parse_any(xml)
    if markup:
        raise InvalidDocumentError(markup)
    return root


def parse_any(xml: bytes) -> "tuple[_Element, tuple[Problem, ...]]":
    """The root element, and the values with a comment, CDATA section or processing instruction.

    Other readers read another value there. The encoding is found as in XML 1.0, appendix F: by
    byte order mark, by declaration, else UTF-8. InvalidDocumentError, with the line, if it is not
    well formed, too large or too deep, or has a DOCTYPE.
    """
    from lxml import etree  # noqa: PLC0415 - `pqsec --help` must not load lxml

    if len(xml) > MAX_DOCUMENT:
        raise invalid(f"larger than {MAX_DOCUMENT} bytes, so not a document of this kind")
    with library_call(_not_well_formed):
        root = etree.fromstring(xml, _parser())
    if root.getroottree().docinfo.internalDTD is not None:
        raise invalid("has a DOCTYPE, which is not allowed: remove it")
    markup = tuple(islice(_markup_in_values(root), MAX_PROBLEMS))
    etree.strip_tags(root, etree.Comment, etree.ProcessingInstruction)
    return root, markup


def _not_well_formed(error: BaseException) -> InvalidDocumentError:
    """With the line that lxml's XMLSyntaxError has; its other errors have none."""
    reason, _, _ = (getattr(error, "msg", None) or words_of(error)).partition(", line ")
    line = getattr(error, "lineno", None) or 1
    return invalid(f"not well-formed XML: {shown(reason.strip())}", line)


def _markup_in_values(root: "_Element") -> Iterator[Problem]:
    """Elements that hold text alone, but not as plain text.

    Fast DDS (tinyxml2) reads a value up to such markup, Python's ElementTree too; Cyclone DDS and
    OpenSSL-based readers read on: each a value of its own.
    """
    from lxml import etree  # noqa: PLC0415 - `pqsec --help` must not load lxml

    markup: dict[_Element, str] = {}
    for tag, what in _MARKUP.items():
        for node in root.iter(getattr(etree, tag)):
            parent = node.getparent()
            if parent is not None and _is_value(parent):
                markup.setdefault(parent, what)
    if _CDATA in etree.tostring(root, encoding="unicode"):
        for element in root.iter(etree.Element):
            if _is_value(element) and _CDATA in etree.tostring(
                element, encoding="unicode", with_tail=False
            ):
                markup.setdefault(element, "a CDATA section")
    for element, what in markup.items():
        words = f"readers differ: {what} in a value, where Fast DDS stops reading; write plain text"
        yield problem(element, words, Code.READERS_DISAGREE)


def _is_value(element: "_Element") -> bool:
    """Whether it has no element in it."""
    return next(element.iterchildren("*"), None) is None


@cache
def _parser() -> "XMLParser":
    from lxml import etree  # noqa: PLC0415 - `pqsec --help` must not load lxml

    return etree.XMLParser(
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        huge_tree=False,  # so libxml2 stops at depth 256 and at 10 MB of text in one place
        strip_cdata=False,  # else nothing shows that a value was in such a section
    )


def with_line_feeds(xml: bytes) -> bytes:
    """`xml` with LF for CRLF, as parsers read it (XML 1.0, 2.11): so signed and unsigned are equal.

    Unchanged if it has another CR, or a code in which these octets may be something else.
    """
    plain = xml.replace(b"\r\n", b"\n")
    return plain if xml.startswith(b"<") and b"\0" not in xml and b"\r" not in plain else xml


def invalid(message: str, line: int | None = None) -> InvalidDocumentError:
    """The error for a document with one problem."""
    return InvalidDocumentError([Problem(message, line=line)])


def problem(element: "_Element", message: str, code: Code = Code.OTHER) -> Problem:
    """The problem `message`, with the element and its line."""
    line: int = element.sourceline  # type: ignore[assignment] # lxml-stubs leave its type open
    return Problem(message, code, line=line, element=shown(element.tag))
