"""Validates a document against its schema, and lists everything that is wrong with it."""

import re
from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
from functools import cache
from itertools import islice
from threading import Lock
from typing import TYPE_CHECKING

from pqsec_pki._assets import asset
from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents._xml import MAX_PROBLEMS, invalid, parse, parse_any, problem
from pqsec_pki.errors import InvalidDocumentError, library_call, shown, words_of
from pqsec_pki.problems import Code, Problem

if TYPE_CHECKING:
    from lxml.etree import XMLSchema, _Element, _LogEntry


_ONE_AT_A_TIME = Lock()
"""All users of a compiled schema share its error log. libxml2's table of built-in types, which is
filled when the first schema is compiled, has no lock."""


class Kind(StrEnum):
    """The two documents of DDS-Security 1.1, 9.4.1."""

    GOVERNANCE = "governance"
    PERMISSIONS = "permissions"


@dataclass(frozen=True, slots=True)
class Extensions:
    """What a stack takes in documents beyond the schema."""

    elements: Mapping[tuple[str, str], str]
    """(parent, element) -> the element of the schema in whose place it stands; "" if none."""
    attributes: frozenset[str]
    """Of any element."""
    skipped: tuple[str, str]
    """(attribute, value) of elements that the stack skips if it does not know them."""

    def remove_from(self, root: "_Element") -> None:
        """Remove or replace them: what remains must match the schema."""
        name, value = self.skipped
        for element in list(root.iter("*")):
            parent = element.getparent()
            instead = None if parent is None else self.elements.get((parent.tag, element.tag))
            if instead:
                element.tag = instead
            elif parent is not None and (instead == "" or element.get(name) == value):
                parent.remove(element)
            for each in self.attributes.intersection(element.attrib):
                del element.attrib[each]


_KIND_OF_CONTENT = {"domain_access_rules": Kind.GOVERNANCE, "permissions": Kind.PERMISSIONS}

_TYPES = {
    "xs:boolean": "true or false",
    "Time": "a time such as 2030-01-31T00:00:00Z",
    "xs:nonNegativeInteger": "a domain id, 0 or more",
}

# Message of libxml2 (xmlschemas.c) -> message for users.
_MISPLACED = (
    (r"This element is not expected\. Expected is (?:one of )?\( (?P<right>.*) \)\.",
     "is not expected here; expected: {right}"),
    (r"This element is not expected\.", "is not expected here"),
)  # fmt: skip
_OTHERS = (
    (r"Missing child element\(s\)\. Expected is (?:one of )?\( (?P<right>.*) \)\.",
     "is not complete; expected next: {right}"),
    (r"\[facet 'enumeration'\] The value '(?P<wrong>.*)' is not .* the set \{(?P<right>.*)\}\.",
     "'{wrong}' is not one of {right}"),
    (r"'(?P<wrong>.*)' is not a valid value of the (?:atomic|union) type '(?P<right>.*)'\.",
     "'{wrong}' is not {right}"),
    (r"The attribute '(?P<wrong>.*)' is not allowed\.", "has no attribute '{wrong}'"),
    (r"The attribute '(?P<right>.*)' is required but missing\.", "lacks its attribute '{right}'"),
    (r"Element content is not allowed, because the type definition is simple\.",
     "holds text only, no elements"),
    (r"Character content other than whitespace is not allowed.*", "holds elements only, no text"),
    (r"No matching global declaration available for the validation root\.",
     "is not the root element <dds>, which has no namespace"),
)  # fmt: skip
_RULES = tuple(
    (pattern, words, code)
    for code, rows in ((Code.ELEMENT_MISPLACED, _MISPLACED), (Code.OTHER, _OTHERS))
    for pattern, words in rows
)
_PLACE = r"Element '(?:\{[^}]*\})?(?P<name>[^']*)'(?:, attribute '[^']*')?: "


def validate(xml: bytes, extensions: Extensions | None = None, *, any_markup: bool = False) -> Kind:
    """Validate `xml`, and return which of the two documents it is.

    It may also have the `extensions` of a stack. InvalidDocumentError if it is not XML; else it
    lists everything that breaks the schema, with line, element and rule; if several children of an
    element are out of place, only the first.
    """
    root = parse_any(xml)[0] if any_markup else parse(xml)
    if extensions:
        extensions.remove_from(root)
    kind = _kind(root)
    _check(root, kind)
    return kind


def read(
    xml: bytes, kind: Kind, *, any_markup: bool = False
) -> "tuple[_Element, tuple[Problem, ...]]":
    """The root element of a valid document of that kind, and its values with markup.

    Errors as in `validate`, and unless `any_markup` for these values.
    """
    root, markup = parse_any(xml)
    if markup and not any_markup:
        raise InvalidDocumentError(markup)
    found = _kind(root)
    if found is not kind:
        raise InvalidDocumentError([problem(root, f"is a {found} document, not a {kind} one")])
    _check(root, kind)
    return root, markup


def _kind(root: "_Element") -> Kind:
    for child in root:
        if found := _KIND_OF_CONTENT.get(child.tag):
            return found
    message = "is not a <dds> with <domain_access_rules> or <permissions> in it"
    raise InvalidDocumentError([problem(root, message)])


def _check(root: "_Element", kind: Kind) -> None:
    with _ONE_AT_A_TIME:
        schema = _schema(kind)
        with library_call(lambda error: invalid(f"cannot be validated: {words_of(error)}")):
            is_valid = schema.validate(root)
        if is_valid:
            return
        log: Iterable[_LogEntry] = schema.error_log  # type: ignore[assignment] # lxml-stubs has no __iter__
        problems = tuple(_problems(log))
    raise InvalidDocumentError(problems)


def load_schemas() -> None:
    """Load lxml and both schemas, so that processes forked later have them."""
    for kind in Kind:
        _schema(kind)


@cache
def _schema(kind: Kind) -> "XMLSchema":
    from lxml import etree  # noqa: PLC0415 - `pqsec --help` must not load lxml

    return etree.XMLSchema(etree.fromstring(asset("schemas", f"{kind}.xsd").read_bytes()))


def _problems(log: "Iterable[_LogEntry]") -> Iterator[Problem]:
    entries = iter(log)
    for entry in islice(entries, MAX_PROBLEMS):
        found = re.match(_PLACE, entry.message)
        message, code = _plain(entry.message[found.end() :] if found else entry.message)
        element = shown(found["name"]) if found else None
        yield Problem(message, code, line=entry.line, element=element)
    if rest := sum(1 for _ in entries):
        yield Problem(f"and {rest} more")


def _plain(message: str) -> tuple[str, Code]:
    for pattern, words, code in _RULES:
        if found := re.fullmatch(pattern, message, re.DOTALL):
            terms = {name: _term(term) for name, term in found.groupdict().items()}
            return words.format_map(terms), code
    return shown(message, limit=200), Code.OTHER


def _term(term: str) -> str:
    return _TYPES.get(term) or shown(term, limit=200)
