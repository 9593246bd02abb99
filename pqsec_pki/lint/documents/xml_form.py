"""Rules about the form of a whole document: stacks do not use the schema."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import Any

from pqsec_pki.lint.document import Document
from pqsec_pki.lint.documents._extensions import all_but
from pqsec_pki.lint.documents.xml_elements import (
    newer_element,
    out_of_order,
    unknown_attribute,
    unknown_element,
)
from pqsec_pki.lint.documents.xml_values import (
    lower_case,
    missing_element,
    nameless_grant,
    no_default,
    no_domains,
    odd_boolean,
    payload_origin,
    spaces,
)
from pqsec_pki.lint.permissions.times import unreadable_time
from pqsec_pki.lint.rule import (
    CYCLONE,
    FAST,
    SIX_STACKS,
    Affected,
    Severity,
    Violation,
    lint_rule,
    stacks_text,
)
from pqsec_pki.problems import Code, Problem
from pqsec_pki.stacks import Stack

ERROR, WARNING, _ = Severity
_CYCLONE, _FAST = Stack.CYCLONEDDS, Stack.FASTDDS


@lint_rule(
    "PQS201", ERROR, "a document cannot be read",
    why="The XML is not well-formed, or the S/MIME around it is broken. No stack starts with it."
    " pqsec also refuses a DOCTYPE, because entities can be used for attacks.",
    fix="Write it again with `pqsec governance render` or `pqsec permissions render`. Then sign it"
    " with `pqsec sign-governance` or `pqsec sign-permissions`.",
    rows=("PEM or DER p7 instead of S/MIME",), measured=SIX_STACKS,
    bad="<default>DENY</defalt>",
    good="<default>DENY</default>",
)  # fmt: skip
def cannot_be_read(document: Document) -> Iterator[Violation]:
    is_reported = document.file.is_signed and document.xml is None  # by PQS331 and PQS333
    if document.reason and not is_reported:
        yield Violation(f"cannot be read: {document.reason}")


@lint_rule(
    "PQS202", ERROR, "a document does not match its schema",
    why="Each stack has its own parser. One may accept by chance what another refuses. Only a valid"
    " document means the same to all stacks.",
    fix="Correct what the message names. `pqsec validate` lists the errors that remain.",
    rows=("missing liveliness element",), measured=SIX_STACKS,
    bad="<rtps_protection_kind>SIGNED</rtps_protection_kind>",
    good="<rtps_protection_kind>SIGN</rtps_protection_kind>",
)  # fmt: skip
def breaks_schema(document: Document) -> Iterator[Violation]:
    if not document.problems or type(document) is Document:
        return
    reported = {found.line for check in _EXPLAINED for found in check(document)}
    misplaced = any(out_of_order(document)) or any(missing_element(document))
    for problem, taken in _schema_problems(document):
        is_reported = misplaced and problem.code is Code.ELEMENT_MISPLACED
        if not is_reported and document.line(problem.line) not in reported:
            element = f"<{problem.element}>: " if problem.element else ""
            found = document.at(problem.line, f"{element}{problem.message}")
            yield replace(found, stacks=all_but(taken))


def _schema_problems(document: Document) -> Iterator[tuple[Problem, Affected]]:
    """Each difference from the schema, with the stacks that take it.

    After an element out of its place the schema compares no more; a stack that takes it goes on.
    """
    beyond = document.text.problems_beyond if document.text else {}
    for problem in document.problems:
        yield problem, {stack: "" for stack, left in beyond.items() if problem not in left}
    for problem in dict.fromkeys(chain.from_iterable(beyond.values())):
        if problem not in document.problems:
            yield problem, {}


@lint_rule(
    "PQS203", ERROR, "a file is neither governance nor permissions",
    why="The root element must be <dds> and contain <domain_access_rules> or <permissions>, in"
    " lower case and without a namespace. Cyclone DDS refuses a default xmlns, which Fast DDS"
    " ignores; Fast DDS refuses upper case.",
    fix="Name the elements as in the standard, and remove xmlns=... from the root element.",
    rows=("default xmlns", "upper-case tags"), measured=SIX_STACKS,
    bad="""
        <dds xmlns="urn:example">
          ...
        </dds>
    """,
    good="""
        <dds>
          ...
        </dds>
    """,
)  # fmt: skip
def neither(document: Document) -> Iterator[Violation]:
    if type(document) is not Document or document.root is None:
        return
    root = document.root
    namespace, _, name = root.tag.rpartition("}")
    if namespace and name == "dds":
        found = document.at(root, "the elements must not be in a namespace")
        yield replace(found, stacks=all_but(FAST))
        text = "the elements are in a namespace: Fast DDS ignores it, and nothing was checked"
        yield replace(found, message=text, stacks=FAST, severity=WARNING)
    elif root.tag != "dds" and root.tag.lower() == "dds":
        yield document.at(root, f"<{root.tag}> must be <dds>: all tags are in lower case")
    elif root.tag != "dds":
        yield document.at(root, "the root element is not <dds>: neither governance nor permissions")
    else:
        yield document.at(root, "<dds> has neither <domain_access_rules> nor <permissions> in it")


@lint_rule(
    "PQS204", ERROR, "the XML starts with a byte order mark",
    why="Cyclone DDS refuses a document with a byte order mark.",
    fix="Save it as UTF-8 without BOM.",
    stacks=CYCLONE, rows=("UTF-8 BOM in XML",), measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1",
    bad=r"$ printf '\xef\xbb\xbf' | cat - k/enclaves/governance.xml > governance.xml",
    good="$ cp k/enclaves/governance.xml governance.xml",
)  # fmt: skip
def byte_order_mark(document: Document) -> Iterator[Violation]:
    if document.tree and document.tree.byte_order_mark:
        yield document.at(1, "starts with a byte order mark, which Cyclone DDS refuses")


@lint_rule(
    "PQS205", WARNING, "the XML is not in UTF-8",
    why="Stacks do not look at the declaration: they read the octets as they are. A signed document"
    " with letters that are other octets in UTF-8 says something else to them: pqsec refuses it.",
    fix='Save it as UTF-8, and declare it: <?xml version="1.0" encoding="UTF-8"?>.',
    measured="Cyclone DDS 0.10.2, 11.0.1; Fast DDS 2.9.1",
    bad="$ sed s/UTF-8/ISO-8859-1/ k/enclaves/governance.xml > governance.xml",
    good="$ cp k/enclaves/governance.xml governance.xml",
)  # fmt: skip
def not_utf8(document: Document) -> Iterator[Violation]:
    if document.tree and document.tree.encoding not in {"UTF-8", "UTF8", "US-ASCII", "ASCII"}:
        yield document.at(1, f"is in {document.tree.encoding[:20]}; stacks read UTF-8")


@lint_rule(
    "PQS220", WARNING, "the meaning of a document was not checked",
    why="The document does not match its schema. A stack that accepts it may read it in any way."
    " The rules about protection and permissions need a valid document.",
    fix="Fix the other findings of this document, and check again.",
    rows=("booleans TRUE/FALSE, 1/0",),
    bad="<default>deny</default>",
    good="<default>DENY</default>",
)  # fmt: skip
def neither_kind(document: Document) -> Iterator[Violation]:
    if not document.problems or type(document) is Document:
        return
    taken = document.taken_by
    found = document.at(document.root, "does not match its schema, so its meaning was not checked")
    yield replace(found, stacks=all_but(taken))
    if taken:
        text = f"has elements that only {stacks_text(taken)} takes, so its meaning was not checked"
        yield replace(found, message=text, stacks=taken, severity=Severity.INFO)


_EXPLAINED: tuple[Callable[[Any], Iterable[Violation]], ...] = (
    unknown_attribute, out_of_order, unknown_element, newer_element, odd_boolean, spaces,
    lower_case, payload_origin, nameless_grant, no_default, no_domains, missing_element,
    unreadable_time,
)  # fmt: skip
"""Rules that report differences from the schema better than the schema does."""
