"""Domains and patterns in either document: what stacks read otherwise than it is written."""

import re
from collections.abc import Iterator

from pqsec_pki.access import opendds_reads_beyond
from pqsec_pki.documents import Node
from pqsec_pki.lint.document import Document
from pqsec_pki.lint.rule import Family, Severity, Target, Violation

FAMILY = Family("documents")

ERROR, WARNING, INFO = Severity
MAX_DOMAIN = 230
MAX_STARS = 4
_BRACE = re.compile(r"\{[^{},]*+,[^{}]*+\}")
_CARET = re.compile(r"\[\^")
_PATTERNS = ("topic", "topic_expression", "partition")
# A bracket that Cyclone DDS reads otherwise: []a], [a-], [a]-b, [[:digit:]], and an open one.
# Each looked at from its last [, so that the work is linear.
_ODD_BRACKET = re.compile(r"\[(?:[!^]?\]|[^\[\]]*+(?:(?<=-)\]|\]-|\[[:.=]|\Z))")
_CYCLONE, _FAST, _OPENDDS = Target.CYCLONEDDS, Target.FASTDDS, Target.OPENDDS
_CYCLONES = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1"


def _number(node: Node | None) -> int | None:
    text = node.value.lstrip("+") if node else ""
    return (
        int(text) if text.isascii() and text.isdigit() and len(text) < len(f"{1 << 64}") else None
    )


@FAMILY.rule(
    "PQS231", ERROR, Document, "a range of domains without end",
    why="Cyclone DDS and Fast DDS read <min>0</min> alone as domain 0 and no other, against the"
    " standard; OpenDDS and Connext read it as all from there on.",
    fix=f"Give it <max>, at most {MAX_DOMAIN}.",
    rows=("id_range with only `<min>0` on domain 16",),
    measured=f"{_CYCLONES}, Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def open_range(document: Document) -> Iterator[Violation]:
    for node in document.all("id_range"):
        if node.child("min") and not node.child("max"):
            yield document.at(node, "the range has no <max>: some stacks read its <min> alone")


@FAMILY.rule(
    "PQS232", ERROR, Document, "a range of domains without start",
    why="Cyclone DDS does not read it as the domains up to <max>.",
    fix="Give it <min>0</min>.",
    stacks=(_CYCLONE,), rows=("id_range with only `<max>`",), measured=_CYCLONES,
)  # fmt: skip
def range_without_start(document: Document) -> Iterator[Violation]:
    for node in document.all("id_range"):
        if node.child("max") and not node.child("min"):
            yield document.at(node, "the range has no <min>: Cyclone DDS finds no domain in it")


@FAMILY.rule(
    "PQS233", ERROR, Document, f"a domain above {MAX_DOMAIN}",
    why="Cyclone DDS refuses the whole document; the ports of RTPS end there.",
    fix=f"Stay at or below {MAX_DOMAIN}.",
    stacks=(_CYCLONE,), rows=("domain id/max 231, 232",), measured=_CYCLONES,
)  # fmt: skip
def domain_too_high(document: Document) -> Iterator[Violation]:
    for node in document.all("id", "min", "max"):
        number = _number(node)
        if number is None and node.value.isdigit():
            number = MAX_DOMAIN + 1
        if number is not None and number > MAX_DOMAIN:
            yield document.at(node, f"domain {node.value[:20]} is above {MAX_DOMAIN}")


@FAMILY.rule(
    "PQS234", ERROR, Document, "a range of domains with none in it",
    why="<min> is above <max>: the rule is for no domain.",
    fix="Exchange the two.",
)  # fmt: skip
def empty_range(document: Document) -> Iterator[Violation]:
    for node in document.all("id_range"):
        first, last = _number(node.child("min")), _number(node.child("max"))
        if first is not None and last is not None and first > last:
            yield document.at(node, f"no domain lies between {first} and {last}")


@FAMILY.rule(
    "PQS235", ERROR, Document, "braces in a pattern",
    why="{a,b} is the shell's, not fnmatch's: no stack takes it for alternatives.",
    fix="Write one topic for each.",
    rows=("brace `{T,U}` in topic",), measured="all six stacks",
)  # fmt: skip
def braces(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if _BRACE.search(node.value):
            yield document.at(node, f"{node.value[:60]!a}: braces are no alternatives here")


@FAMILY.rule(
    "PQS236", ERROR, Document, "[^...] in a pattern",
    why="Cyclone DDS and OpenDDS do not take [^a] for 'any but a', as Fast DDS does.",
    fix="Write [!a], which all stacks take so.",
    stacks=(_CYCLONE, _OPENDDS), rows=("`[^A-C]`",), measured=f"{_CYCLONES}; OpenDDS by source",
)  # fmt: skip
def caret(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if _CARET.search(node.value):
            yield document.at(node, f"{node.value[:60]!a}: write [!...], not [^...]")


@FAMILY.rule(
    "PQS237", WARNING, Document, "a pattern with many stars",
    why="Cyclone DDS tries every way to share a name among the stars, and the time multiplies with"
    " each: four stars and a name of 200 letters took 0.2 s, five 10 s, six take minutes. Whoever"
    " is in the domain chooses the name.",
    fix="Write out what the stars stand for, in several topics if need be.",
    stacks=(_CYCLONE,), measured="Cyclone DDS 0.10.2; the C library, and so Fast DDS, is quick",
)  # fmt: skip
def many_stars(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        stars = len(re.findall(r"\*+", node.value))
        if stars > MAX_STARS:
            yield document.at(node, f"{node.value[:60]!a} has {stars} stars: slow to match")


@FAMILY.rule(
    "PQS238", WARNING, Document, "a backslash in a pattern",
    why="For the standard and OpenDDS it takes the meaning from the character behind it; for"
    " Cyclone DDS and Fast DDS it is a character as any other.",
    fix="Write the pattern without it: [*] is a star for all.",
    measured="Cyclone DDS 0.10.2, Fast DDS 2.9.1; OpenDDS by source",
)  # fmt: skip
def backslash(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if "\\" in node.value:
            yield document.at(node, f"{node.value[:60]!a}: not an escape in all stacks")


@FAMILY.rule(
    "PQS239", WARNING, Document, "a bracket that stacks read in two ways",
    why="In Cyclone DDS a ] always ends a bracket, a - wants a character at both sides, [0-9]-f is"
    " one bracket to the f, there are no classes as [[:digit:]], and an open bracket covers"
    " nothing.",
    fix="Write the members out, or as ranges: [0-9a-f].",
    stacks=(_CYCLONE, _OPENDDS), measured="Cyclone DDS 0.10.2",
)  # fmt: skip
def odd_bracket(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if _ODD_BRACKET.search(node.value):
            yield document.at(node, f"{node.value[:60]!a}: stacks read this bracket differently")


@FAMILY.rule(
    "PQS241", INFO, Document, "a bracket covers ] too",
    why="Cyclone DDS takes the ] that ends a bracket for a member of it: [ab] covers ] as well. It"
    " matters only where names have a ] in them; those of ROS 2 and IDL have none.",
    fix="Nothing, or write a pattern for each name.",
    stacks=(_CYCLONE,), measured="Cyclone DDS 0.10.2", only_when_asked=True,
)  # fmt: skip
def closing_bracket(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if "[" in node.value:
            yield document.at(node, f"{node.value[:60]!a}: Cyclone DDS lets it cover a ] too")


@FAMILY.rule(
    "PQS242", WARNING, Document, "a star that OpenDDS matches once only",
    why="OpenDDS does not look back when what follows a star does not fit: *ab does not cover aab.",
    fix="Let the star stand at the end of the pattern.",
    stacks=(_OPENDDS,), measured="ACE 7.0.8, which OpenDDS calls", only_when_asked=True,
)  # fmt: skip
def star_inside(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if re.search(r"\*[^*]", node.value):
            yield document.at(node, f"{node.value[:60]!a}: OpenDDS does not look back after a star")


@FAMILY.rule(
    "PQS243", ERROR, Document, "a bracket that is not closed",
    why="OpenDDS reads on in memory behind the pattern, and what it then answers is left to chance:"
    " it may allow what nobody granted, or crash.",
    fix="Close the bracket, or write the topics out.",
    stacks=(_OPENDDS,), only_when_asked=True,
    measured="ACE 6.2.1, which OpenDDS 3.13.3 calls, under AddressSanitizer",
)  # fmt: skip
def open_bracket(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if opendds_reads_beyond(node.value):
            yield document.at(node, f"{node.value[:60]!a}: the bracket has no end, nor has it for"
                              " OpenDDS, which reads beyond the pattern")  # fmt: skip
