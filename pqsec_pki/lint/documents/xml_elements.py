"""Rules about elements and attributes, which stacks read with parsers of their own."""

from collections.abc import Iterator
from itertools import pairwise

from pqsec_pki.lint.document import Document
from pqsec_pki.lint.documents._elements import CHILDREN, NEW, SCHEMA_ATTRIBUTES
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, _ = Severity
_CYCLONE, _FAST = Stack.CYCLONEDDS, Stack.FASTDDS


@lint_rule(
    "PQS206", ERROR, "an attribute that stacks do not support",
    why="Cyclone DDS refuses a document with an attribute that it does not support. It supports the"
    " xsi attributes of the root element and the name of a grant.",
    fix="Remove the attribute.",
    stacks=(_CYCLONE,), rows=("xsi:schemaLocation, or any other root attribute",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1",
    bad='<domains><id kind="test">0</id></domains>',
    good="<domains><id>0</id></domains>",
)  # fmt: skip
def unknown_attribute(document: Document) -> Iterator[Violation]:
    for node in document.root.walk() if document.root else ():
        known = SCHEMA_ATTRIBUTES if node is document.root else set()
        known = {"name"} if node.tag == "grant" else known
        for name, _ in node.attributes:
            if name not in known:
                short = name.rpartition("}")[2][:40]
                yield document.at(
                    node, f"Cyclone DDS refuses the attribute {short!a} of a document"
                )


@lint_rule(
    "PQS208", ERROR, "elements out of order",
    why="Fast DDS requires the order of the schema and refuses any other order.",
    fix="Put the elements in the order of the schema; `pqsec ... render` writes this order.",
    stacks=(_FAST,),
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
    why="Every stack refuses the whole document, whether the element is a vendor's extension or a"
    " typing error.",
    fix="Remove the element, or spell it as in the schema.",
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
                yield document.at(child, f"<{child.tag[:40]}> is not allowed in <{parent.tag}>")


@lint_rule(
    "PQS210", ERROR, "an element of DDS-Security 1.2",
    why="All six stacks measured implement DDS-Security 1.1 and refuse the whole document. RTI"
    " Connext 7.5 and later accept it.",
    fix="Remove the element, or use such a document only for participants with RTI Connext.",
    rows=("1.2 `enable_key_revision` / `rtps_psk_protection_kind` / allowed algorithms",),
    measured=SIX_STACKS,
    bad="""
        <rtps_protection_kind>SIGN</rtps_protection_kind>
        <enable_key_revision>true</enable_key_revision>
    """,
    good="<rtps_protection_kind>SIGN</rtps_protection_kind>",
)  # fmt: skip
def newer_element(document: Document) -> Iterator[Violation]:
    for node in document.all(*sorted(NEW)):
        yield document.at(
            node, f"<{node.tag}> is from DDS-Security 1.2, and stacks of 1.1 refuse it"
        )
