"""Rules about grants: too many rights, and parts that stacks ignore."""

from collections.abc import Iterator

from pqsec_pki.documents import DefaultAction, Grant
from pqsec_pki.lint.document import ACTIONS, PermissionsFile
from pqsec_pki.lint.documents._shadows import covers_all
from pqsec_pki.lint.permissions._names import parsed, shown
from pqsec_pki.lint.rule import CYCLONE, FAST, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, INFO = Severity
_CYCLONE, _FAST, _OPENDDS = Stack.CYCLONEDDS, Stack.FASTDDS, Stack.OPENDDS


@lint_rule(
    "PQS251", WARNING, "default ALLOW",
    why="With default ALLOW, everything that no rule matches is allowed, for example after a"
    " forgotten rule. In Fast DDS it has no effect on topics, because Fast DDS never uses the"
    " default for a topic.",
    fix="Write <default>DENY</default>, and an allow_rule for what the participant needs.",
    bad="<default>ALLOW</default>",
    good="<default>DENY</default>",
)  # fmt: skip
def default_allow(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if grant.default is DefaultAction.ALLOW:
            yield document.at(
                grant.line, f"{shown(grant)}: everything that no rule matches is allowed"
            )


@lint_rule(
    "PQS252", ERROR, "default ALLOW without an allow_rule",
    why="Fast DDS lets a participant join only if an allow_rule names the domain. The default does"
    " not matter.",
    fix="Add an allow_rule for the domain.",
    stacks=FAST,
    rows=("`<default>ALLOW` and no rule", "no rule for the domain, default ALLOW"),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
    bad="""
        <!-- no <allow_rule> -->
        <default>ALLOW</default>
    """,
    good="""
        <allow_rule>
          <domains><id>0</id></domains>
        </allow_rule>
        <default>ALLOW</default>
    """,
)  # fmt: skip
def nothing_allowed(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if grant.default is DefaultAction.ALLOW and not any(rule.allow for rule in grant.rules):
            yield document.at(
                grant.line, f"{shown(grant)}: Fast DDS requires an allow_rule to join"
            )


@lint_rule(
    "PQS253", WARNING, "everything is allowed",
    why="An attacker who controls this participant can publish or read any topic.",
    fix="Name the topics that the participant needs. `pqsec permissions new` starts with a node's"
    " own topics.",
    bad="<topic>*</topic>",
    good="<topic>rt/*</topic>",
)  # fmt: skip
def allow_all(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule in grant.rules:
            for action in ACTIONS if rule.allow else ():
                for criteria in getattr(rule, action):
                    if any(map(covers_all, criteria.topics)):
                        yield document.at(
                            criteria.line, f"{shown(grant)} may {action} every topic (*)"
                        )


@lint_rule(
    "PQS259", WARNING, "relay rules, which stacks ignore",
    why="Cyclone DDS and OpenDDS never check <relay>. Fast DDS checks it only for a peer, as a"
    " right to subscribe.",
    fix="Do not rely on <relay>.",
    stacks={**CYCLONE, **FAST, Stack.OPENDDS: ""},
    rows=("`<relay>`, `<data_tags>` present (ignored)",),
    measured="all six stacks; OpenDDS by source",
    bad="""
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
          <relay><topics><topic>rt/state</topic></topics></relay>
        </allow_rule>
    """,
    good="""
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </allow_rule>
    """,
)  # fmt: skip
def relay(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("relay"):
        yield document.at(node, "<relay> is not enforced as such by any stack")


@lint_rule(
    "PQS260", WARNING, "data tags, which stacks ignore",
    why="No stack checks data tags: what they should limit is allowed with any tag.",
    fix="Use partitions or other topics.",
    stacks={**CYCLONE, **FAST, Stack.OPENDDS: ""},
    rows=("`<relay>`, `<data_tags>` present (ignored)",),
    measured="all six stacks; OpenDDS by source",
    bad="""
        <publish>
          <topics><topic>rt/chatter</topic></topics>
          <data_tags>
            <tag><name>floor</name><value>1</value></tag>
          </data_tags>
        </publish>
    """,
    good="""
        <publish>
          <topics><topic>rt/chatter</topic></topics>
        </publish>
    """,
)  # fmt: skip
def data_tags(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("data_tags"):
        yield document.at(node, "<data_tags> are not enforced by any stack")


@lint_rule(
    "PQS261", WARNING, "two grants for one subject",
    why="The first grant decides, even if it has expired. Cyclone DDS then refuses the participant,"
    " Fast DDS tries the next grant, and OpenDDS ignores the second one.",
    fix="Put the rules of both into one grant.",
    rows=("first grant for subject not valid, second valid",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1; OpenDDS by source",
    bad="""
        <grant name="one">
          ...
        </grant>
        <grant name="two">
          ...
        </grant>
    """,
    good="""
        <grant name="one">
          ...
        </grant>
        <grant name="two">
          <subject_name>CN=/listener</subject_name>
          ...
        </grant>
    """,
)  # fmt: skip
def two_grants(document: PermissionsFile) -> Iterator[Violation]:
    before: dict[object, Grant] = {}
    for grant in document.grants:
        # A non-ASCII name needs two grants, one spelling for each group of stacks (PQS418, PQS425).
        name: object = (
            parsed(grant.subject_name) or grant.subject_name,
            grant.subject_name.isascii(),
        )
        if name in before:
            first = document.line(before[name].line)
            yield document.at(grant.line, f"{shown(grant)} already has a grant in line {first}")
        before.setdefault(name, grant)
