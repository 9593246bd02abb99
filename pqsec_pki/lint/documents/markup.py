"""Rules about markup that a stack's own parser cannot read, although it is well-formed XML.

pqsec signs none of it: it writes documents in one form. It matters for documents that other
programs signed. `tests/interop/test_markup.py` compares each row with the stack itself.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from itertools import pairwise

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import Token, TokenKind
from pqsec_pki.lint.document import Document, GovernanceFile
from pqsec_pki.lint.rule import FAST, Affected, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR = Severity.ERROR
_CYCLONE: Affected = {Stack.CYCLONEDDS: "0.10.2, 11.0.1"}
LONGEST_REFERENCE = 16
"""Octets of the longest reference that Cyclone DDS reads, without its `&`."""
_LONG = re.compile(rb"&[^;]{%d,};" % LONGEST_REFERENCE)
_UNENDED = re.compile(rb"&(?![^;]{1,%d};)" % (LONGEST_REFERENCE - 1))
_PLAIN, _TYPOGRAPHIC = {'"': '"', "'": "'"}, {"\u201c": "\u201d", "\u2018": "\u2019"}
"""Cyclone DDS takes a value that begins with one of these for a string, and searches its end."""
_TAGS = (TokenKind.START, TokenKind.EMPTY, TokenKind.END)
_NODES = {TokenKind.COMMENT: "a comment", TokenKind.CDATA: "a CDATA section"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Unreadable:
    """A kind of markup that a stack cannot read."""

    words: str
    fix: str
    """What to write instead."""
    find: Callable[[Document], Iterator[int]]
    """The lines where it is."""
    stacks: Affected = field(default_factory=lambda: _CYCLONE)


def _end_tags(document: Document) -> Iterator[int]:
    for each in document.tokens:
        if each.kind is TokenKind.END and each.octets[-2:-1].isspace():
            yield each.line


def _long_references(document: Document) -> Iterator[int]:
    for each in document.tokens:
        if each.kind in {TokenKind.START, TokenKind.EMPTY, TokenKind.TEXT} and _LONG.search(
            each.octets
        ):
            yield each.line


class _Next:
    """The next place of a pattern: asked for places in their order, it searches each only once."""

    def __init__(self, pattern: re.Pattern[bytes], xml: bytes) -> None:
        self._pattern, self._xml, self._found = pattern, xml, -1

    def after(self, begin: int) -> int:
        """Where it is next, from `begin` on; the end of the document if it is not."""
        if self._found < begin:
            found = self._pattern.search(self._xml, begin)
            self._found = found.start() if found else len(self._xml)
        return self._found


def _quotes(document: Document, pairs: Mapping[str, str]) -> Iterator[int]:
    """Of values only: the text of other elements is white space."""
    xml = document.text.xml if document.text else b""
    unended = _Next(_UNENDED, xml)
    ends = {each.encode(): _Next(re.compile(end.encode()), xml) for each, end in pairs.items()}
    for before, text in pairwise(document.tokens):
        value = text.octets.lstrip()
        quote = next((each for each in ends if value.startswith(each)), None)
        if quote and before.kind is TokenKind.START and text.kind is TokenKind.TEXT:
            begin = text.end - len(value) + len(quote)
            end = ends[quote].after(begin)
            if end == len(xml) or unended.after(begin) < end:
                yield text.line


def _between_elements(document: Document, wanted: Callable[[Token], bool]) -> Iterator[int]:
    """The lines of wanted tokens that are in elements with elements in them."""
    found: list[tuple[bool, list[int]]] = [(False, [])]
    for each in document.tokens:
        if each.kind in {TokenKind.START, TokenKind.EMPTY}:
            found[-1] = (True, found[-1][1])
        if each.kind is TokenKind.START:
            found.append((False, []))
        elif each.kind is TokenKind.END:
            has_elements, lines = found.pop()
            yield from lines if has_elements else ()
        elif wanted(each):
            found[-1][1].append(each.line)


def _is_section(token: Token) -> bool:
    return token.kind is TokenKind.CDATA


def _is_reference(token: Token) -> bool:
    return token.kind is TokenKind.TEXT and b"&" in token.octets


UNREADABLE = (
    Unreadable(
        words="white space before the > of an end tag",
        fix="write </topic>, not </topic >",
        find=_end_tags,
    ),
    Unreadable(
        words="a CDATA section between elements",
        fix="remove it",
        find=lambda document: _between_elements(document, _is_section),
    ),
    Unreadable(
        words="a character reference between elements",
        fix="write the white space itself",
        find=lambda document: _between_elements(document, _is_reference),
    ),
    Unreadable(
        words=f"a character reference of more than {LONGEST_REFERENCE - 1} characters",
        fix="write it without leading zeros, or write the character itself",
        find=_long_references,
    ),
    Unreadable(
        words="a value that begins with a quotation mark, and has no second one",
        fix="write &quot; for \", and &apos; for '",
        find=lambda document: _quotes(document, _PLAIN),
    ),
    Unreadable(
        words="a value that begins with a typographic quotation mark, and has no second one",
        fix="write a character reference: &#8220; or &#8216;",
        find=lambda document: _quotes(document, _TYPOGRAPHIC),
        stacks={Stack.CYCLONEDDS: "0.10.2"},
    ),
)
"""For Cyclone DDS: in its source, ddsrt/src/xmlparser.c."""


@lint_rule(
    "PQS278", ERROR, "markup that Cyclone DDS cannot read",
    why="Cyclone DDS has a parser of its own, which does not know all of XML. It refuses the whole"
    " document.",
    fix="Write it as the finding says. What `pqsec sign-governance` and `pqsec sign-permissions`"
    " sign has none of it.",
    stacks=_CYCLONE,
    bad="<domains><id>0</id></domains >",
    good="<domains><id>0</id></domains>",
)  # fmt: skip
def unreadable(document: Document) -> Iterator[Violation]:
    for kind in UNREADABLE:
        for line in kind.find(document):
            found = document.at(line, f"{kind.words}: Cyclone DDS cannot read it; {kind.fix}")
            yield replace(found, stacks=kind.stacks)


@lint_rule(
    "PQS279", ERROR, "a processing instruction that Fast DDS cannot read",
    why="Fast DDS takes processing instructions only at the begin of a document, before the root"
    " element and before any comment. It refuses the document.",
    fix="Remove it, or put it directly below the XML declaration.",
    stacks={Stack.FASTDDS: "2.9.1"},
    bad="<domains><?editor folded?><id>0</id></domains>",
    good="<domains><id>0</id></domains>",
)  # fmt: skip
def instruction(document: Document) -> Iterator[Violation]:
    at_begin = True
    for each in document.tokens:
        if each.kind is not TokenKind.INSTRUCTION:
            at_begin = at_begin and each.kind is TokenKind.TEXT
        elif not at_begin:
            text = "a processing instruction after the begin: Fast DDS cannot read it; remove it"
            yield document.at(each.line, text)


@lint_rule(
    "PQS207", ERROR, "something directly before </dds>",
    why="Fast DDS reads a comment, a CDATA section or a character reference there as a second set"
    " of rules, and refuses the governance.",
    fix="Move the comment into <domain_access_rules>, or above the root element; remove anything"
    " else.",
    stacks=FAST, rows=("comment directly before `</dds>` in governance",),
    bad="""
        <dds>
          ...
          <!-- end -->
        </dds>
    """,
    good="""
        <dds>
          <!-- start -->
          ...
        </dds>
    """,
)  # fmt: skip
def before_the_end(document: GovernanceFile) -> Iterator[Violation]:
    after_the_rules = False
    for each in document.tokens:
        if each.kind in _TAGS:
            after_the_rules = each.kind is TokenKind.END and each.name == "domain_access_rules"
        elif after_the_rules and (each.kind in _NODES or _is_reference(each)):
            what = _NODES.get(each.kind, "a character reference")
            yield document.at(each.line, f"Fast DDS refuses {what} directly before </dds>")
