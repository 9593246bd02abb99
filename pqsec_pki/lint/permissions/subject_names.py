"""Rules about the form of subject names in permissions, which each stack compares differently."""

import re
from collections.abc import Iterator

from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.permissions._names import CUTS, named, parsed, repeated, shown
from pqsec_pki.lint.rule import CYCLONE, FAST, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR = Severity.ERROR
MAX_PIECES = 20
"""The maximum for one name in Cyclone DDS."""
_CYCLONE, _FAST, _OPENDDS = Stack.CYCLONEDDS, Stack.FASTDDS, Stack.OPENDDS
_SPACED = re.compile(r"\s=|(?<!\\)=\s|(?<!\\),\s|\s,")


@lint_rule(
    "PQS411", ERROR, "a subject_name is not a subject name",
    why="No certificate has this subject, so no participant can use the grant.",
    fix="Copy the name from `pqsec inspect cert.pem`: CN=/talker.",
    bad="<subject_name>talker</subject_name>",
    good="<subject_name>CN=/talker</subject_name>",
)  # fmt: skip
def invalid_name(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("subject_name"):
        if not parsed(node.value):
            shown = node.value[:60]
            yield document.at(node, f"{shown!a} is not a subject name such as CN=/talker")


@lint_rule(
    "PQS412", ERROR, "spaces or line ends around a subject_name",
    why="Fast DDS includes them in the comparison and finds no grant.",
    fix="Write it directly between the tags, on one line.",
    stacks=FAST, rows=("newlines/indent around the text",),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
    bad="""
        <subject_name>
          CN=/talker
        </subject_name>
    """,
    good="<subject_name>CN=/talker</subject_name>",
)  # fmt: skip
def padded_name(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("subject_name"):
        if node.text != node.value and node.value:
            yield document.at(node, "spaces or line ends around the subject name")


@lint_rule(
    "PQS413", ERROR, "spaces inside a subject_name",
    why="Cyclone DDS 0.10 refuses CN=x, O=Lab and C = ES. openssl prints names in this form by"
    " default.",
    fix="Write CN=x,O=Lab,C=ES.",
    stacks={Stack.CYCLONEDDS: "0.10.2, 0.10.5"},
    rows=("`CN=x, O=Lab, C=ES`", "`C = ES, O = Lab, CN = x` (openssl default print)"),
    measured="Cyclone DDS 0.10.2, 0.10.5",
    bad="<subject_name>CN=/talker, O=Lab</subject_name>",
    good="<subject_name>CN=/talker,O=Lab</subject_name>",
)  # fmt: skip
def spaced_name(document: PermissionsFile) -> Iterator[Violation]:
    for grant, _, _ in named(document):
        if _SPACED.search(grant.subject_name):
            yield document.at(grant.line, f"{shown(grant)}: remove the spaces around , and =")


@lint_rule(
    "PQS414", ERROR, "a subject_name written with slashes",
    why="Fast DDS does not accept /C=ES/O=Lab/CN=x.",
    fix="Write CN=x,O=Lab,C=ES.",
    stacks=FAST, rows=("`/C=ES/O=Lab/CN=x`",), measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
    bad="<subject_name>/CN=talker</subject_name>",
    good="<subject_name>CN=talker</subject_name>",
)  # fmt: skip
def slashed_name(document: PermissionsFile) -> Iterator[Violation]:
    for grant, _, _ in named(document):
        if grant.subject_name.startswith("/"):
            yield document.at(grant.line, f"{shown(grant)}: Fast DDS requires commas")


@lint_rule(
    "PQS415", ERROR, "a subject_name in the order of the certificate",
    why="Fast DDS 2.9.1 requires the order of RFC 2253: the last part of the certificate's subject"
    " first.",
    fix="Reverse the order (CN first), or add a second grant with that order.",
    stacks={Stack.FASTDDS: "2.9.1"}, rows=("`C=ES,O=Lab,CN=x` (DER order; what OpenDDS needs)",
                           "two grants, one per order"),
    measured="Fast DDS 2.9.1",
    bad="<subject_name>C=ES,O=Lab,CN=/talker</subject_name>",
    good="<subject_name>CN=/talker,O=Lab,C=ES</subject_name>",
)  # fmt: skip
def certificate_order(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, reversed_too in named(document):
        if _is_common(name[-1]) and not _is_common(name[0]) and not reversed_too:
            yield document.at(grant.line, f"{shown(grant)}: Fast DDS 2.9 requires CN first")


@lint_rule(
    "PQS416", ERROR, "a subject_name in the order of RFC 2253",
    why="OpenDDS requires the order of the certificate's subject. A subject with CN alone has only"
    " one order.",
    fix="Add a second grant with the order of the certificate's subject (CN last).",
    stacks=(_OPENDDS,), rows=("`CN=x,O=Lab,C=ES` (RFC 2253 = reversed, no spaces)",),
    measured="OpenDDS, its SubjectName.cpp compiled and run", only_when_asked=True,
    bad="<subject_name>CN=/talker,O=Lab,C=ES</subject_name>",
    good="<subject_name>C=ES,O=Lab,CN=/talker</subject_name>",
)  # fmt: skip
def reversed_order(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, reversed_too in named(document):
        if _is_common(name[0]) and not _is_common(name[-1]) and not reversed_too:
            yield document.at(grant.line, f"{shown(grant)}: OpenDDS requires CN last")


@lint_rule(
    "PQS419", ERROR, "an attribute type twice in a subject_name",
    why="If a subject has two OUs, Cyclone DDS reads only the first, and Fast DDS 3 finds no"
    " grant.",
    fix="Issue the certificate with one of them.",
    stacks={**CYCLONE, Stack.FASTDDS: "3.1.2, 3.6.2", Stack.ROS2: ""},
    rows=("two OUs",),
    bad="<subject_name>CN=/talker,OU=Lab,OU=Robots</subject_name>",
    good="<subject_name>CN=/talker,OU=Lab</subject_name>",
)  # fmt: skip
def repeated_part(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, _ in named(document):
        if twice := repeated(name):
            yield document.at(grant.line, f"{shown(grant)} has {twice} twice")


@lint_rule(
    "PQS420", ERROR, "a multi-valued part in a subject_name",
    why="No stack matches CN=x+OU=y.",
    fix="Issue the certificate with separate parts, or with CN alone.",
    rows=("multi-valued RDN",), measured="all six stacks",
    bad="<subject_name>CN=/talker+OU=Lab</subject_name>",
    good="<subject_name>CN=/talker,OU=Lab</subject_name>",
)  # fmt: skip
def joined_parts(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, _ in named(document):
        if any(len(part) > 1 for part in name):
            yield document.at(grant.line, f"{shown(grant)} has parts joined by +")


@lint_rule(
    "PQS424", ERROR, "a subject_name that Cyclone DDS can never match",
    why="Cyclone DDS splits names at each , / and |. It finds no grant for a name with an empty"
    f" piece, such as CN=/a//b, or with more than {MAX_PIECES} pieces.",
    fix="Choose a name without double slashes, or with a shorter path.",
    stacks={Stack.CYCLONEDDS: "0.10.2"}, measured="Cyclone DDS 0.10.2",
    bad="<subject_name>CN=/fleet//robot1</subject_name>",
    good="<subject_name>CN=/fleet/robot1</subject_name>",
)  # fmt: skip
def unmatched_pieces(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, _ in named(document):
        pieces = CUTS.split(",".join(f"{word}={value}" for part in name for word, value in part))
        if "" in pieces[:-1]:
            yield document.at(grant.line, f"{shown(grant)} has an empty piece between separators")
        elif len(pieces) > MAX_PIECES:
            words = f"{len(pieces)} pieces; Cyclone DDS accepts at most {MAX_PIECES}"
            yield document.at(grant.line, f"{shown(grant)} has {words}")


def _is_common(part: frozenset[tuple[str, str]]) -> bool:
    return any(word == "CN" for word, _ in part)
