"""Rules about elements and attributes, which stacks read with parsers of their own."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from pqsec_pki.documents import Node, TokenKind
from pqsec_pki.lint.document import Document
from pqsec_pki.lint.documents._elements import CHILDREN, NEW, SCHEMA_ATTRIBUTES
from pqsec_pki.lint.documents._extensions import all_but, takers
from pqsec_pki.lint.rule import CYCLONE, FAST, SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, _ = Severity
_CYCLONE, _FAST = Stack.CYCLONEDDS, Stack.FASTDDS


@lint_rule(
    "PQS206", ERROR, "an attribute that stacks do not support",
    why="Cyclone DDS refuses a document with an attribute that it does not support, and reads a"
    " declared namespace as an attribute too. It supports xmlns:xsi, with this prefix,"
    " xsi:noNamespaceSchemaLocation, and the name of a grant.",
    fix="Remove the attribute.",
    stacks=CYCLONE, rows=("xsi:schemaLocation, or any other root attribute",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1",
    bad='<domains><id kind="test">0</id></domains>',
    good="<domains><id>0</id></domains>",
)  # fmt: skip
def unknown_attribute(document: Document) -> Iterator[Violation]:
    for tag in document.tokens:
        for name, _ in tag.attributes if tag.kind in {TokenKind.START, TokenKind.EMPTY} else ():
            if name not in SCHEMA_ATTRIBUTES and (tag.name, name) != ("grant", "name"):
                yield document.at(
                    tag.line, f"Cyclone DDS refuses the attribute {name[:40]!a} of a document"
                )


@lint_rule(
    "PQS208", ERROR, "elements out of order",
    why="Fast DDS requires the order of the schema and refuses any other order.",
    fix="Put the elements in the order of the schema; `pqsec ... render` writes this order.",
    stacks=FAST,
    rows=(
        "governance elements out of XSD order",
        "permissions elements out of XSD order (default/validity/domains)",
    ),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2 refuse; Cyclone DDS takes it",
    bad="""
        <validity>
          <not_after>2027-06-01T00:00:00Z</not_after>
          <not_before>2026-05-01T00:00:00Z</not_before>
        </validity>
    """,
    good="""
        <validity>
          <not_before>2026-05-01T00:00:00Z</not_before>
          <not_after>2027-06-01T00:00:00Z</not_after>
        </validity>
    """,
)  # fmt: skip
def out_of_order(document: Document) -> Iterator[Violation]:
    for parent in document.all(*CHILDREN):
        steps = {tag: n for n, step in enumerate(CHILDREN[parent.tag]) for tag in step}
        known = [child for child in parent.children if child.tag in steps]
        for one, other in pairwise(known):
            if steps[one.tag] > steps[other.tag]:
                yield document.at(other, f"<{other.tag}> must be before <{one.tag}>")
                break


@lint_rule(
    "PQS209", ERROR, "an element that stacks do not support",
    why="Every stack refuses the whole document, whether the element is another vendor's extension"
    " or a typing error. The finding names the stacks, if there are some that take it.",
    fix="Remove the element, or spell it as in the schema; or use such a document only for"
    " participants with a stack that takes it, and check it with --target.",
    rows=("unknown/vendor element",), measured=SIX_STACKS,
    bad="""
        <domains>
          <priority>1</priority>
          <id>0</id>
        </domains>
    """,
    good="""
        <domains>
          <id>0</id>
        </domains>
    """,
)  # fmt: skip
def unknown_element(document: Document) -> Iterator[Violation]:
    for parent in document.all(*CHILDREN):
        known = {tag for step in CHILDREN[parent.tag] for tag in step}
        for child in parent.children:
            if child.tag not in known | NEW:
                text = f"<{child.tag[:40]}> is not allowed in <{parent.tag}>"
                yield from _judged(document, child, parent.tag, text)


@lint_rule(
    "PQS210", ERROR, "an element of DDS-Security 1.2",
    why="All six stacks measured implement DDS-Security 1.1 and refuse the whole document. RTI"
    " Connext takes it, from the version in the finding on.",
    fix="Remove the element, or use such a document only for participants with RTI Connext, and"
    " check it with --target connext.",
    stacks=all_but({Stack.CONNEXT: ""}),
    rows=("1.2 `enable_key_revision` / `rtps_psk_protection_kind` / allowed algorithms",),
    measured=SIX_STACKS,
    bad="""
        <rtps_protection_kind>SIGN</rtps_protection_kind>
        <enable_key_revision>true</enable_key_revision>
    """,
    good="<rtps_protection_kind>SIGN</rtps_protection_kind>",
)  # fmt: skip
def newer_element(document: Document) -> Iterator[Violation]:
    for parent in document.all(*CHILDREN):
        for node in parent.all(*NEW):
            text = f"<{node.tag}> is from DDS-Security 1.2, and stacks of 1.1 refuse it"
            yield from _judged(document, node, parent.tag, text)


def _judged(document: Document, node: Node, parent: str, text: str) -> Iterator[Violation]:
    """An error for the stacks that refuse the element; for those that take it, their versions."""
    taken = takers(parent, node)
    yield replace(document.at(node, text), stacks=all_but(taken))
    if taken:
        note = f"<{node.tag[:40]}> is not in DDS-Security 1.1: other stacks refuse the document"
        found = document.at(node, note)
        yield replace(found, stacks=taken, severity=Severity.INFO)
