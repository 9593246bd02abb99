"""Rules about topic and partition patterns, which stacks read differently."""

import re
from collections.abc import Iterator

from pqsec_pki.access import follows_locale, opendds_reads_beyond
from pqsec_pki.lint.document import Document
from pqsec_pki.lint.rule import CYCLONE, CYCLONES, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, INFO = Severity
MAX_STARS = 4
_BRACE = re.compile(r"\{[^{},]*+,[^{}]*+\}")
_CARET = re.compile(r"\[\^")
_PATTERNS = ("topic", "topic_expression", "partition")
# Brackets that Cyclone DDS reads differently: []a], [a-], [a]-b, [[:digit:]], and an open one.
# The expression starts at the last [ of each, so that the search takes linear time.
_ODD_BRACKET = re.compile(r"\[(?:[!^]?\]|[^\[\]]*+(?:(?<=-)\]|\]-|\[[:.=]|\Z))")
_CYCLONE, _OPENDDS = Stack.CYCLONEDDS, Stack.OPENDDS


@lint_rule(
    "PQS235", ERROR, "braces in a pattern",
    why="{a,b} works in a shell, but not in fnmatch. No stack reads it as alternatives.",
    fix="Write one topic for each alternative.",
    rows=("brace `{T,U}` in topic",), measured="all six stacks",
    bad="<topic>rt/{chatter,cmd}</topic>",
    good="""
        <topic>rt/chatter</topic>
        <topic>rt/cmd</topic>
    """,
)  # fmt: skip
def braces(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if _BRACE.search(node.value):
            yield document.at(node, f"{node.value[:60]!a}: braces do not mean alternatives here")


@lint_rule(
    "PQS236", ERROR, "[^...] in a pattern",
    why="Cyclone DDS and OpenDDS do not read [^a] as 'any character except a'. Fast DDS does.",
    fix="Write [!a], which all stacks read in this way.",
    stacks={**CYCLONE, Stack.OPENDDS: ""},
    rows=("`[^A-C]`",), measured=f"{CYCLONES}; OpenDDS by source",
    bad="<topic>rt/[^a]*</topic>",
    good="<topic>rt/[!a]*</topic>",
)  # fmt: skip
def caret(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if _CARET.search(node.value):
            yield document.at(node, f"{node.value[:60]!a}: write [!...], not [^...]")


@lint_rule(
    "PQS237", WARNING, "a pattern with many stars",
    why="Cyclone DDS tries every way to match a name, and each star multiplies the time. With a"
    " name of 200 letters, four stars took 0.2 s, five took 10 s, and six take minutes. Any"
    " participant of the domain can choose such a name.",
    fix="Replace the stars with names, in several topics if necessary.",
    stacks={Stack.CYCLONEDDS: "0.10.2"},
    measured="Cyclone DDS 0.10.2; the C library, and so Fast DDS, is quick",
    bad="<topic>*a*b*c*d*e*</topic>",
    good="<topic>a*b*e</topic>",
)  # fmt: skip
def many_stars(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        stars = len(re.findall(r"\*+", node.value))
        if stars > MAX_STARS:
            yield document.at(node, f"{node.value[:60]!a} has {stars} stars and is slow to match")


@lint_rule(
    "PQS238", WARNING, "a backslash in a pattern",
    why="In the standard and in OpenDDS, a backslash escapes the next character. In Cyclone DDS and"
    " Fast DDS it is an ordinary character.",
    fix="Write the pattern without a backslash: [*] matches a star in all stacks.",
    measured="Cyclone DDS 0.10.2, Fast DDS 2.9.1; OpenDDS by source",
    bad=r"<topic>rt/\*</topic>",
    good="<topic>rt/[*]</topic>",
)  # fmt: skip
def backslash(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if "\\" in node.value:
            yield document.at(
                node, f"{node.value[:60]!a}: a backslash is not an escape in all stacks"
            )


@lint_rule(
    "PQS239", WARNING, "a bracket that stacks read differently",
    why="In Cyclone DDS, a ] always ends a bracket, and a - needs a character on both sides."
    " [0-9]-f is one bracket that ends at f. Classes such as [[:digit:]] do not exist, and a"
    " bracket that is not closed matches nothing.",
    fix="List the characters, or write ranges: [0-9a-f].",
    stacks={Stack.CYCLONEDDS: "0.10.2", Stack.OPENDDS: ""}, measured="Cyclone DDS 0.10.2",
    bad="<topic>rt/[a-]</topic>",
    good="<topic>rt/[a]</topic>",
)  # fmt: skip
def odd_bracket(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if _ODD_BRACKET.search(node.value):
            yield document.at(node, f"{node.value[:60]!a}: stacks read this bracket differently")


@lint_rule(
    "PQS241", INFO, "a bracket also matches ]",
    why="Cyclone DDS also matches the ] that ends a bracket: [ab] matches ] too. This matters only"
    " for names with a ], which ROS 2 and IDL do not have.",
    fix="Nothing needs to be done, or write a pattern for each name.",
    stacks={Stack.CYCLONEDDS: "0.10.2"}, measured="Cyclone DDS 0.10.2", only_when_asked=True,
    bad="<topic>rt/arm[12]</topic>",
    good="""
        <topic>rt/arm1</topic>
        <topic>rt/arm2</topic>
    """,
)  # fmt: skip
def closing_bracket(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if "[" in node.value:
            yield document.at(node, f"{node.value[:60]!a}: in Cyclone DDS it also matches a ]")


@lint_rule(
    "PQS242", WARNING, "a star inside a pattern, which OpenDDS matches only once",
    why="OpenDDS does not backtrack if the text after a star does not match: *ab does not match"
    " aab.",
    fix="Put the star at the end of the pattern.",
    stacks=(_OPENDDS,), measured="ACE 7.0.8, which OpenDDS calls", only_when_asked=True,
    bad="<topic>rt/*/state</topic>",
    good="""
        <topic>rt/arm/state</topic>
        <topic>rt/leg/state</topic>
    """,
)  # fmt: skip
def star_inside(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if re.search(r"\*[^*]", node.value):
            yield document.at(node, f"{node.value[:60]!a}: OpenDDS does not backtrack after a star")


@lint_rule(
    "PQS244", WARNING, "a pattern that depends on the locale",
    why="Fast DDS calls fnmatch, which follows the locale of the process. In C, as in a C++ node, ?"
    " and [!a] match an octet. In C.UTF-8, as in a Python node, they also match a character such as"
    " é, of two octets. So participants of one domain may decide differently.",
    fix="List the characters in ASCII, as [0-9a-z], or write a star. `pqsec explain --as"
    " fastdds/C.UTF-8` shows the decision of Python nodes.",
    stacks=(Stack.FASTDDS,), measured="Fast DDS 2.9.1; glibc 2.36, 2.41",
    bad="<topic>rt/arm?</topic>",
    good="<topic>rt/arm[0-9]</topic>",
)  # fmt: skip
def of_locale(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if follows_locale(node.value):
            yield document.at(
                node, f"{node.value[:60]!a}: in a UTF-8 locale it matches other names than in C"
            )


@lint_rule(
    "PQS269", WARNING, "a topic with the name of a builtin topic",
    why="Cyclone DDS lets every participant of the domain use its builtin topics, such as"
    " DCPSTopic. Governance and permissions have no effect on them.",
    fix="Give the topic another name.",
    stacks={Stack.CYCLONEDDS: "0.10.2"}, measured="Cyclone DDS 0.10.2",
    bad="<topic>DCPSTopic</topic>",
    good="<topic>rt/chatter</topic>",
)  # fmt: skip
def builtin_name(document: Document) -> Iterator[Violation]:
    for node in document.all("topic", "topic_expression"):
        if node.value.startswith("DCPS"):
            yield document.at(
                node, f"{node.value[:60]!a}: names that begin with DCPS are builtin topics"
            )


@lint_rule(
    "PQS243", ERROR, "a bracket that is not closed",
    why="OpenDDS reads memory after the end of the pattern, so its answer is undefined. It may"
    " allow what is not granted, or crash.",
    fix="Close the bracket, or list the topics.",
    stacks={Stack.OPENDDS: "3.13.3"}, only_when_asked=True,
    measured="ACE 6.2.1, which OpenDDS 3.13.3 calls, under AddressSanitizer",
    bad="<topic>rt/[ab</topic>",
    good="<topic>rt/[ab]</topic>",
)  # fmt: skip
def open_bracket(document: Document) -> Iterator[Violation]:
    for node in document.all(*_PATTERNS):
        if opendds_reads_beyond(node.value):
            yield document.at(node, f"{node.value[:60]!a}: the bracket has no end, so OpenDDS"
                              " reads beyond the pattern")  # fmt: skip
