"""Rules about attribute types and letters in subject names that stacks write differently."""

import re
from collections.abc import Iterator

from pqsec_pki.certificates import MAX_COMMON_NAME
from pqsec_pki.documents import Grant, Subject
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.permissions._names import named, shown
from pqsec_pki.lint.rule import CYCLONE, CYCLONES, FAST, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, _ = Severity
_CYCLONE, _FAST, _OPENDDS = Stack.CYCLONEDDS, Stack.FASTDDS, Stack.OPENDDS

_WORDS = frozenset(
    ("CN", "C", "ST", "L", "O", "OU", "DC", "UID", "emailAddress", "serialNumber", "street",
     "SN", "GN", "initials", "title", "dnQualifier", "pseudonym", "generationQualifier",
     "postalCode", "postalAddress", "businessCategory", "organizationIdentifier",
     "unstructuredName", "x500UniqueIdentifier")
)  # fmt: skip
_SPELLED = {word.lower(): word for word in _WORDS}
_PLAIN = re.compile(r"[A-Za-z0-9_./ -]*")


@lint_rule(
    "PQS417", ERROR,
    "an attribute type in a subject_name that stacks do not support",
    why="Stacks compare attribute types exactly with OpenSSL's short names. cn=, STREET= and"
    " 2.5.4.5= never match.",
    fix="Write OpenSSL's short names: CN, O, C, emailAddress, serialNumber, street.",
    rows=("`cn=` lower-case type, or value case",
          "emailAddress/serialNumber as dotted OID (`rfc4514_string()` default)",
          "emailAddress/serialNumber by OpenSSL short name"),
    measured="all six stacks",
    bad="<subject_name>cn=/talker</subject_name>",
    good="<subject_name>CN=/talker</subject_name>",
)  # fmt: skip
def unknown_word(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, _ in named(document):
        for word in sorted({word for part in name for word, _ in part}):
            if word[0].isdigit():
                yield document.at(grant.line, f"{shown(grant)}: write OpenSSL's name for {word}")
            elif word not in _WORDS and word.lower() in _SPELLED:
                right = _SPELLED[word.lower()]
                yield document.at(grant.line, f"{shown(grant)}: write {right}, not {word}")


@lint_rule(
    "PQS418", ERROR, "non-ASCII letters in a subject_name, not escaped",
    why=r"Cyclone DDS and OpenDDS require \C3\A9 for é, and otherwise find no grant.",
    fix="Add a second grant with that spelling, or use only ASCII.",
    stacks={**CYCLONE, Stack.OPENDDS: "3.34"},
    rows=("UTF-8 value written raw", "… both as two grants"),
    measured=f"{CYCLONES}; OpenDDS 3.34, its access control run",
    bad="<subject_name>CN=café</subject_name>",
    good="<subject_name>CN=coffee</subject_name>",
)  # fmt: skip
def written_raw(document: PermissionsFile) -> Iterator[Violation]:
    for grant in _spelled_once(document):
        if not grant.subject_name.isascii():
            yield document.at(
                grant.line,
                rf"{shown(grant)}: escape each octet as \xx for Cyclone DDS and"
                rf" OpenDDS",
            )


@lint_rule(
    "PQS421", ERROR, "a comma or quote in a subject_name",
    why='OpenDDS cannot read O="Acme, Inc", although it prints names in this form.',
    fix="Issue the certificate without commas and quotes.",
    stacks=(_OPENDDS,), rows=('value with `,` `=` `+` `"` `#`, `&#124;`, `&`',),
    measured="OpenDDS, its SubjectName.cpp compiled and run", only_when_asked=True,
    bad=r"<subject_name>O=Acme\, Inc,CN=/talker</subject_name>",
    good="<subject_name>O=Acme Inc,CN=/talker</subject_name>",
)  # fmt: skip
def comma_in_value(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, _ in named(document):
        if any(set(value) & {",", '"'} for part in name for _, value in part):
            yield document.at(grant.line, f"{shown(grant)}: OpenDDS cannot read a comma or quotes")


@lint_rule(
    "PQS422", WARNING, "a common name that is too long",
    why=f"X.509 allows {MAX_COMMON_NAME} characters at most: no certificate can contain this name.",
    fix="Shorten the name.",
    bad="""
        <subject_name>CN=/building-12/second-floor/loading-bay/charging-station/robot-1/front</subject_name>
    """,
    good="<subject_name>CN=/building-12/loading-bay/robot-1/front</subject_name>",
)  # fmt: skip
def long_name(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, _ in named(document):
        longest = max((len(v) for part in name for word, v in part if word == "CN"), default=0)
        if longest > MAX_COMMON_NAME:
            yield document.at(
                grant.line,
                f"the common name has {longest} characters; at most {MAX_COMMON_NAME} are allowed",
            )


@lint_rule(
    "PQS423", WARNING, "a common name with unusual characters",
    why="Each stack splits and compares subjects in its own way. Letters, digits, _ . / - and inner"
    " spaces were tested in all stacks. Cyclone DDS splits a name at |.",
    fix="Use only these characters.",
    rows=('value with `,` `=` `+` `"` `#`, `&#124;`, `&`',), measured="all six stacks",
    bad="<subject_name>CN=/robot;1</subject_name>",
    good="<subject_name>CN=/robot_1</subject_name>",
)  # fmt: skip
def odd_characters(document: PermissionsFile) -> Iterator[Violation]:
    for grant, name, _ in named(document):
        values = [value for part in name for word, value in part if word == "CN"]
        odd = sorted(
            {c for value in values for c in value if c.isascii() and not _PLAIN.fullmatch(c)}
        )
        if odd:
            yield document.at(grant.line, f"{shown(grant)}: avoid {ascii(' '.join(odd))[1:-1]}")


@lint_rule(
    "PQS425", ERROR, "non-ASCII letters in a subject_name, escaped",
    why=r"Fast DDS requires é itself, not \C3\A9, and otherwise finds no grant.",
    fix="Add a second grant with the letters themselves, or use only ASCII.",
    stacks=FAST, rows=(r"UTF-8 value written `\C3\A9`", "… both as two grants"),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
    bad=r"<subject_name>CN=caf\C3\A9</subject_name>",
    good="<subject_name>CN=coffee</subject_name>",
)  # fmt: skip
def written_as_octets(document: PermissionsFile) -> Iterator[Violation]:
    for grant in _spelled_once(document):
        if grant.subject_name.isascii():
            yield document.at(grant.line, f"{shown(grant)}: Fast DDS requires unescaped letters")


def _spelled_once(document: PermissionsFile) -> Iterator[Grant]:
    """Grants with non-ASCII letters for which no other grant has the other spelling."""
    spellings: dict[Subject, set[bool]] = {}
    for grant, name, _ in named(document):
        spellings.setdefault(name, set()).add(grant.subject_name.isascii())
    for grant, name, _ in named(document):
        letters = "".join(value for part in name for _, value in part)
        if not letters.isascii() and len(spellings[name]) == 1:
            yield grant
