"""How permissions write the subject a grant is for: each stack compares in its own way."""

import re
from collections.abc import Iterator

from pqsec_pki.documents import Grant, Subject
from pqsec_pki.lint._names import CUTS, parsed, repeated, shown
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.rule import Family, Found, Severity, Target

FAMILY = Family("naming")

ERROR, WARNING, _ = Severity
MAX_COMMON_NAME = 64
"""X.520, ub-common-name."""
MAX_PIECES = 20
"""Of a name, in Cyclone DDS."""
_CYCLONE, _FAST, _OPENDDS = Target.CYCLONEDDS, Target.FASTDDS, Target.OPENDDS
_CYCLONES = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1"

_WORDS = frozenset(
    ("CN", "C", "ST", "L", "O", "OU", "DC", "UID", "emailAddress", "serialNumber", "street",
     "SN", "GN", "initials", "title", "dnQualifier", "pseudonym", "generationQualifier",
     "postalCode", "postalAddress", "businessCategory", "organizationIdentifier",
     "unstructuredName", "x500UniqueIdentifier")
)  # fmt: skip
_SPELLED = {word.lower(): word for word in _WORDS}
_PLAIN = re.compile(r"[A-Za-z0-9_./ -]*")
_SPACED = re.compile(r"\s=|(?<!\\)=\s|(?<!\\),\s|\s,")


def _named(document: PermissionsFile) -> Iterator[tuple[Grant, Subject, list[Subject]]]:
    """Each grant with a name that can be read, and those of the other grants."""
    names = [(grant, parsed(grant.subject_name)) for grant in document.grants]
    all_names = {name for _, name in names}
    for grant, name in names:
        if name:
            yield grant, name, [name[::-1]] if name[::-1] in all_names - {name} else []


@FAMILY.rule(
    "PQS411", ERROR, PermissionsFile, "a subject_name that is no name",
    why="It is nobody's, so no participant is let in with this grant.",
    mend="Copy it from `pqsec inspect cert.pem`: CN=/talker.",
)  # fmt: skip
def no_name(document: PermissionsFile) -> Iterator[Found]:
    for node in document.all("subject_name"):
        if not parsed(node.value):
            shown = node.value[:60]
            yield document.at(node, f"{shown!a} is no subject name as CN=/talker")


@FAMILY.rule(
    "PQS412", ERROR, PermissionsFile, "spaces or line ends around a subject_name",
    why="Fast DDS compares with them and finds no grant.",
    mend="Write it directly between the tags, on one line.",
    stacks=(_FAST,), rows=("newlines/indent around the text",),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def padded_name(document: PermissionsFile) -> Iterator[Found]:
    for node in document.all("subject_name"):
        if node.text != node.value and node.value:
            yield document.at(node, "spaces or line ends around the subject name")


@FAMILY.rule(
    "PQS413", ERROR, PermissionsFile, "spaces inside a subject_name",
    why="Cyclone DDS 0.10 refuses CN=x, O=Lab and C = ES, which openssl prints by default.",
    mend="Write CN=x,O=Lab,C=ES.",
    stacks=(_CYCLONE,),
    rows=("`CN=x, O=Lab, C=ES`", "`C = ES, O = Lab, CN = x` (openssl default print)"),
    measured="Cyclone DDS 0.10.2, 0.10.5",
)  # fmt: skip
def spaced_name(document: PermissionsFile) -> Iterator[Found]:
    for grant, _, _ in _named(document):
        if _SPACED.search(grant.subject_name):
            yield document.at(grant.line, f"{shown(grant)}: no spaces around , and =")


@FAMILY.rule(
    "PQS414", ERROR, PermissionsFile, "a subject_name written with slashes",
    why="Fast DDS does not take /C=ES/O=Lab/CN=x.",
    mend="Write CN=x,O=Lab,C=ES.",
    stacks=(_FAST,), rows=("`/C=ES/O=Lab/CN=x`",), measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def slashed_name(document: PermissionsFile) -> Iterator[Found]:
    for grant, _, _ in _named(document):
        if grant.subject_name.startswith("/"):
            yield document.at(grant.line, f"{shown(grant)}: Fast DDS wants commas")


@FAMILY.rule(
    "PQS415", ERROR, PermissionsFile, "a subject_name in the order of the certificate",
    why="Fast DDS 2.9.1 wants the order of RFC 2253, the last part of the certificate first.",
    mend="Turn it round (CN first), or add a second grant with that order.",
    stacks=(_FAST,), rows=("`C=ES,O=Lab,CN=x` (DER order; what OpenDDS needs)",
                           "two grants, one per order"),
    measured="Fast DDS 2.9.1",
)  # fmt: skip
def certificate_order(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, reversed_too in _named(document):
        if _is_common(name[-1]) and not _is_common(name[0]) and not reversed_too:
            yield document.at(grant.line, f"{shown(grant)}: Fast DDS 2.9 wants CN first")


@FAMILY.rule(
    "PQS416", ERROR, PermissionsFile, "a subject_name in the order of RFC 2253",
    why="OpenDDS wants the order of the certificate. A subject of CN alone has one order only.",
    mend="Add a second grant with the order of the certificate (CN last).",
    stacks=(_OPENDDS,), rows=("`CN=x,O=Lab,C=ES` (RFC 2253 = reversed, no spaces)",),
    measured="OpenDDS, its SubjectName.cpp compiled and run", only_when_asked=True,
)  # fmt: skip
def reversed_order(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, reversed_too in _named(document):
        if _is_common(name[0]) and not _is_common(name[-1]) and not reversed_too:
            yield document.at(grant.line, f"{shown(grant)}: OpenDDS wants CN last")


@FAMILY.rule(
    "PQS417", ERROR, PermissionsFile, "a word in a subject_name that stacks do not know",
    why="Words are compared letter by letter with OpenSSL's: cn=, STREET= and 2.5.4.5= match none.",
    mend="Write OpenSSL's short names: CN, O, C, emailAddress, serialNumber, street.",
    rows=("`cn=` lower-case type, or value case",
          "emailAddress/serialNumber as dotted OID (`rfc4514_string()` default)",
          "emailAddress/serialNumber by OpenSSL short name"),
    measured="all six stacks",
)  # fmt: skip
def unknown_word(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, _ in _named(document):
        for word in sorted({word for part in name for word, _ in part}):
            if word[0].isdigit():
                yield document.at(grant.line, f"{shown(grant)}: write OpenSSL's name for {word}")
            elif word not in _WORDS and word.lower() in _SPELLED:
                right = _SPELLED[word.lower()]
                yield document.at(grant.line, f"{shown(grant)}: write {right}, not {word}")


@FAMILY.rule(
    "PQS418", ERROR, PermissionsFile, "letters beyond ASCII, written as they are",
    why=r"Cyclone DDS and OpenDDS want \C3\A9 for é, and find no grant otherwise.",
    mend="Add a second grant with that spelling, or stay within ASCII.",
    stacks=(_CYCLONE, _OPENDDS),
    rows=("UTF-8 value written raw", "… both as two grants"),
    measured=f"{_CYCLONES}; OpenDDS, its SubjectName.cpp compiled and run",
)  # fmt: skip
def written_raw(document: PermissionsFile) -> Iterator[Found]:
    for grant in _spelled_once(document):
        if not grant.subject_name.isascii():
            yield document.at(grant.line, rf"{shown(grant)}: Cyclone DDS wants \.. for each octet")


@FAMILY.rule(
    "PQS419", ERROR, PermissionsFile, "two parts of one kind in a subject_name",
    why="Of two OUs Cyclone DDS sees the first only, and Fast DDS 3 finds no match.",
    mend="Issue the certificate with one of them.",
    rows=("two OUs",), measured=f"{_CYCLONES}, Fast DDS 3.1.2, 3.6.2",
)  # fmt: skip
def repeated_part(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, _ in _named(document):
        if twice := repeated(name):
            yield document.at(grant.line, f"{shown(grant)} has {twice} twice")


@FAMILY.rule(
    "PQS420", ERROR, PermissionsFile, "a subject_name with a part of several values",
    why="No stack matches CN=x+OU=y.",
    mend="Issue the certificate with separate parts, or with CN alone.",
    rows=("multi-valued RDN",), measured="all six stacks",
)  # fmt: skip
def joined_parts(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, _ in _named(document):
        if any(len(part) > 1 for part in name):
            yield document.at(grant.line, f"{shown(grant)} has parts joined by +")


@FAMILY.rule(
    "PQS421", ERROR, PermissionsFile, "a comma or quote in a subject_name",
    why='OpenDDS cannot read O="Acme, Inc", not even as it prints it itself.',
    mend="Issue the certificate without them.",
    stacks=(_OPENDDS,), rows=('value with `,` `=` `+` `"` `#`, `&#124;`, `&`',),
    measured="OpenDDS, its SubjectName.cpp compiled and run", only_when_asked=True,
)  # fmt: skip
def comma_in_value(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, _ in _named(document):
        if any(set(value) & {",", '"'} for part in name for _, value in part):
            yield document.at(grant.line, f"{shown(grant)}: OpenDDS cannot read , or quotes")


@FAMILY.rule(
    "PQS422", WARNING, PermissionsFile, "a common name that is too long",
    why=f"X.509 ends it at {MAX_COMMON_NAME} characters: no certificate can carry it.",
    mend="Shorten the name.",
)  # fmt: skip
def long_name(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, _ in _named(document):
        longest = max((len(v) for part in name for word, v in part if word == "CN"), default=0)
        if longest > MAX_COMMON_NAME:
            yield document.at(
                grant.line, f"the common name has {longest} characters, of 64 at most"
            )


@FAMILY.rule(
    "PQS423", WARNING, PermissionsFile, "a common name with unusual characters",
    why="Stacks cut and compare subjects each in its own way. Letters, digits, _ . / - and spaces"
    " inside were tried in all; | cuts a name in two in Cyclone DDS.",
    mend="Stay within these.",
    rows=('value with `,` `=` `+` `"` `#`, `&#124;`, `&`',), measured="all six stacks",
)  # fmt: skip
def odd_characters(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, _ in _named(document):
        values = [value for part in name for word, value in part if word == "CN"]
        odd = sorted(
            {c for value in values for c in value if c.isascii() and not _PLAIN.fullmatch(c)}
        )
        if odd:
            yield document.at(grant.line, f"{shown(grant)}: avoid {ascii(' '.join(odd))[1:-1]}")


@FAMILY.rule(
    "PQS424", ERROR, PermissionsFile, "a subject_name that Cyclone DDS can never match",
    why="Cyclone DDS cuts names at each , / and |. It finds no grant for a name with an empty"
    f" piece in it, as CN=/a//b, nor with more than {MAX_PIECES} pieces.",
    mend="Choose a name without double slashes, and with a shorter path.",
    stacks=(_CYCLONE,), measured="Cyclone DDS 0.10.2",
)  # fmt: skip
def unmatched_pieces(document: PermissionsFile) -> Iterator[Found]:
    for grant, name, _ in _named(document):
        pieces = CUTS.split(",".join(f"{word}={value}" for part in name for word, value in part))
        if "" in pieces[:-1]:
            yield document.at(grant.line, f"{shown(grant)} has an empty piece between separators")
        elif len(pieces) > MAX_PIECES:
            words = f"{len(pieces)} pieces, of which Cyclone DDS takes {MAX_PIECES}"
            yield document.at(grant.line, f"{shown(grant)} has {words}")


@FAMILY.rule(
    "PQS425", ERROR, PermissionsFile, "letters beyond ASCII, written as octets",
    why=r"Fast DDS wants é as it is, not \C3\A9, and finds no grant otherwise.",
    mend="Add a second grant with the letters themselves, or stay within ASCII.",
    stacks=(_FAST,), rows=(r"UTF-8 value written `\C3\A9`", "… both as two grants"),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def written_as_octets(document: PermissionsFile) -> Iterator[Found]:
    for grant in _spelled_once(document):
        if grant.subject_name.isascii():
            yield document.at(grant.line, f"{shown(grant)}: Fast DDS wants the letters themselves")


def _spelled_once(document: PermissionsFile) -> Iterator[Grant]:
    """Grants with letters beyond ASCII that no other grant spells in the other way."""
    spellings: dict[Subject, set[bool]] = {}
    for grant, name, _ in _named(document):
        spellings.setdefault(name, set()).add(grant.subject_name.isascii())
    for grant, name, _ in _named(document):
        letters = "".join(value for part in name for _, value in part)
        if not letters.isascii() and len(spellings[name]) == 1:
            yield grant


def _is_common(part: frozenset[tuple[str, str]]) -> bool:
    return any(word == "CN" for word, _ in part)
