"""Rules about the values of elements in governance and permissions, and missing elements."""

from collections.abc import Iterator
from dataclasses import replace

from pqsec_pki.lint.document import Document, GovernanceFile, PermissionsFile
from pqsec_pki.lint.documents._elements import BOOLEANS, KINDS, NAMES, NEEDED, WORDS
from pqsec_pki.lint.documents._extensions import all_but, replacements
from pqsec_pki.lint.rule import FAST, SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, _ = Severity
_FAST, _OPENDDS = Stack.FASTDDS, Stack.OPENDDS


@lint_rule(
    "PQS211", WARNING, "a boolean that is not true or false",
    why="The schema allows true, false, 1 and 0. All stacks measured accept 1 and TRUE, but they"
    " differ for other values.",
    fix="Write true or false.",
    rows=("booleans TRUE/FALSE, 1/0",), measured=SIX_STACKS,
    bad="<enable_join_access_control>TRUE</enable_join_access_control>",
    good="<enable_join_access_control>true</enable_join_access_control>",
)  # fmt: skip
def odd_boolean(document: Document) -> Iterator[Violation]:
    for node in document.all(*BOOLEANS):
        if node.value not in {"true", "false"} and node.value:
            yield document.at(node, f"<{node.tag}>: write true or false, not {node.value[:20]!a}")


@lint_rule(
    "PQS212", ERROR, "spaces around a value",
    why="Fast DDS does not remove the spaces: it refuses the kind or boolean, and the topic never"
    " matches.",
    fix="Write the value directly between the tags, on one line.",
    stacks=FAST,
    rows=("` true `, ` ENCRYPT `, spaces around topic",),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2; Cyclone DDS trims",
    bad="<topic> rt/chatter </topic>",
    good="<topic>rt/chatter</topic>",
)  # fmt: skip
def spaces(document: Document) -> Iterator[Violation]:
    for node in document.all(*BOOLEANS, *KINDS, *NAMES, "default", "id", "min", "max"):
        if node.text != node.value:
            yield document.at(node, f"<{node.tag}> has spaces or line ends around its value")


@lint_rule(
    "PQS213", ERROR, "a value in lower case",
    why="No stack accepts `encrypt` for ENCRYPT. Cyclone DDS silently reads `deny` or `allow` in"
    " <default> as DENY; Fast DDS refuses both.",
    fix="Write the value in capitals.",
    rows=("`encrypt` lower case", "`<default>` missing or lower case"), measured=SIX_STACKS,
    bad="<default>deny</default>",
    good="<default>DENY</default>",
)  # fmt: skip
def lower_case(document: Document) -> Iterator[Violation]:
    for node in document.all(*KINDS, "default"):
        if node.value not in WORDS and node.value.upper() in WORDS:
            yield document.at(node, f"<{node.tag}>: write {node.value.upper()}, in capitals")


@lint_rule(
    "PQS214", ERROR, "a data_protection_kind with origin authentication",
    why="data_protection_kind can be NONE, SIGN or ENCRYPT. Every stack refuses other values.",
    fix="Set the origin authentication in metadata_protection_kind.",
    rows=("data_protection_kind …_WITH_ORIGIN_AUTHENTICATION",), measured=SIX_STACKS,
    bad="<data_protection_kind>ENCRYPT_WITH_ORIGIN_AUTHENTICATION</data_protection_kind>",
    good="<data_protection_kind>ENCRYPT</data_protection_kind>",
)  # fmt: skip
def payload_origin(document: GovernanceFile) -> Iterator[Violation]:
    for node in document.all("data_protection_kind"):
        if node.value.upper().endswith("_WITH_ORIGIN_AUTHENTICATION"):
            yield document.at(
                node, "data_protection_kind has no origin authentication: stacks refuse it"
            )


@lint_rule(
    "PQS215", ERROR, "a grant without a name",
    why="Fast DDS refuses the document. OpenDDS reads the attribute without a check whether it"
    " exists (source).",
    fix='Add a name: <grant name="/talker">.',
    stacks={**FAST, Stack.OPENDDS: ""},
    rows=("no grant name",), measured="Fast DDS 2.9.1, 3.1.2, 3.6.2; Cyclone DDS takes it",
    bad="""
        <grant>
          ...
        </grant>
    """,
    good="""
        <grant name="talker">
          ...
        </grant>
    """,
)  # fmt: skip
def nameless_grant(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("grant"):
        if "name" not in dict(node.attributes):
            yield document.at(node, "the grant has no name attribute")


@lint_rule(
    "PQS216", ERROR, "a grant without default",
    why="Cyclone DDS reads it as DENY; Fast DDS refuses the document.",
    fix="End each grant with <default>DENY</default>.",
    stacks=FAST,
    rows=("`<default>` missing or lower case",),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2; Cyclone DDS by source",
    bad="<!-- no <default> -->",
    good="<default>DENY</default>",
)  # fmt: skip
def no_default(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("grant"):
        if not node.child("default"):
            yield document.at(node, "the grant has no <default>")


@lint_rule(
    "PQS217", ERROR, "a rule without domains",
    why="Cyclone DDS crashes on a permissions rule without <domains>; Fast DDS refuses it.",
    fix="Start the rule with <domains>, with at least one <id> or <id_range>.",
    rows=("rule without `<domains>`",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1 crash; Fast DDS refuses",
    bad="""
        <allow_rule>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </allow_rule>
    """,
    good="""
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </allow_rule>
    """,
)  # fmt: skip
def no_domains(document: Document) -> Iterator[Violation]:
    for node in document.all("allow_rule", "deny_rule", "domain_rule"):
        domains = node.child("domains")
        if domains is None or not domains.children:
            yield document.at(node, f"<{node.tag}> names no domains, which crashes Cyclone DDS")


@lint_rule(
    "PQS218", ERROR, "an empty topic or expression",
    why="Cyclone DDS crashes on an empty topic or expression. Fast DDS 2.9.1 and 3.1.2 crash on an"
    " empty topic_expression. One such signed document stops every participant.",
    fix="Write the topic, or * for all topics.",
    rows=("empty `<topic_expression/>`", "empty `<topic/>`"),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1, Fast DDS 2.9.1, 3.1.2 crash; 3.6.2 refuses",
    bad="<topic></topic>",
    good="<topic>rt/chatter</topic>",
)  # fmt: skip
def empty_expression(document: Document) -> Iterator[Violation]:
    for node in document.all("topic_expression", "topic"):
        if not node.value:
            yield document.at(node, f"an empty <{node.tag}> crashes Cyclone DDS")


@lint_rule(
    "PQS219", ERROR, "a required element is missing",
    why="No stack has a default for it: Cyclone DDS and Fast DDS refuse the document. Older"
    " templates of SROS2 lack enable_liveliness_protection.",
    fix="Add the element in its place.",
    rows=("missing liveliness element",), measured=SIX_STACKS,
    bad="""
        <validity>
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
def missing_element(document: Document) -> Iterator[Violation]:
    for node in document.all(*NEEDED):
        there = {child.tag for child in node.children}
        for tag in NEEDED[node.tag]:
            if tag not in there:
                found = document.at(node, f"<{node.tag}> lacks <{tag}>")
                yield replace(found, stacks=all_but(replacements(node, tag)))
