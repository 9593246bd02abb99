"""Rules about partitions in permissions, which each stack checks differently."""

import re
from collections.abc import Iterator
from itertools import pairwise

from pqsec_pki.lint.document import ACTIONS, PermissionsFile
from pqsec_pki.lint.permissions._names import criteria_of
from pqsec_pki.lint.rule import FAST, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, INFO = Severity
_CYCLONE, _FAST, _OPENDDS = Stack.CYCLONEDDS, Stack.FASTDDS, Stack.OPENDDS
_INNER_WILDCARD = re.compile(r"[?\[\\]|\*.")


@lint_rule(
    "PQS257", WARNING, "topics and partitions in different criteria",
    why="Fast DDS combines the criteria of a rule: it allows a topic of one in the partitions of"
    " another. Cyclone DDS and the standard keep them separate.",
    fix="Write one allow_rule for each.",
    stacks=FAST, rows=("topic in one `<publish>`, partition in another",),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
    bad="""
        <publish>
          <topics><topic>rt/chatter</topic></topics>
        </publish>
        <publish>
          <topics><topic>rt/state</topic></topics>
          <partitions><partition>floor1</partition></partitions>
        </publish>
    """,
    good="""
        <publish>
          <topics><topic>rt/chatter</topic></topics>
        </publish>
        <publish>
          <topics><topic>rt/state</topic></topics>
        </publish>
    """,
)  # fmt: skip
def mixed_criteria(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule in grant.rules:
            for action in ACTIONS if rule.allow else ():
                for one, other in pairwise(getattr(rule, action)):
                    if one.partitions != other.partitions and one.topics != other.topics:
                        yield document.at(
                            other.line, f"Fast DDS mixes the topics and partitions of the {action}"
                            " elements of one rule",
                        )  # fmt: skip


@lint_rule(
    "PQS258", INFO, "allowed only without a partition",
    why="Other rules of the grant name partitions. An allow_rule without partitions applies to"
    " endpoints without a partition, not to endpoints in every partition.",
    fix="Name the partitions here too; <partition>*</partition> means all.",
    rows=("allow without partitions, endpoint in P", "allow partition P, endpoint in none"),
    measured="all six stacks",
    bad="""
        <publish>
          <topics><topic>rt/state</topic></topics>
          <partitions><partition>floor1</partition></partitions>
        </publish>
        <subscribe>
          <topics><topic>rt/cmd</topic></topics>
        </subscribe>
    """,
    good="""
        <publish>
          <topics><topic>rt/state</topic></topics>
          <partitions><partition>floor1</partition></partitions>
        </publish>
        <subscribe>
          <topics><topic>rt/cmd</topic></topics>
          <partitions><partition>*</partition></partitions>
        </subscribe>
    """,
)  # fmt: skip
def default_partition(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        criteria = [
            each
            for rule in grant.rules
            if rule.allow
            for action in ACTIONS
            for each in getattr(rule, action)
        ]
        if any(each.partitions for each in criteria):
            for each in criteria:
                if not each.partitions:
                    yield document.at(
                        each.line, f"{_some(each.topics)}: allowed only without a partition"
                    )


@lint_rule(
    "PQS256", WARNING, "a deny_rule for some partitions only",
    why="Cyclone DDS and Fast DDS deny the topic in every partition. OpenDDS denies it only in"
    " these partitions, as does Cyclone DDS 0.10 if an earlier allow_rule names the topic, and 11.0"
    " if the other action is allowed. Both compare names: an endpoint in partition secre? or s*"
    " avoids a deny_rule for secret.",
    fix="Name the partitions in an allow_rule instead, and deny the topic without partitions.",
    rows=("deny T only in partition Q, endpoint in none",), measured="all six stacks",
    bad="""
        <deny_rule>
          <domains><id>0</id></domains>
          <publish>
            <topics><topic>rt/cmd</topic></topics>
            <partitions><partition>floor1</partition></partitions>
          </publish>
        </deny_rule>
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/*</topic></topics></publish>
        </allow_rule>
    """,
    good="""
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/cmd</topic></topics></publish>
        </deny_rule>
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/*</topic></topics></publish>
        </allow_rule>
    """,
)  # fmt: skip
def deny_in_partition(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule in grant.rules:
            for action in () if rule.allow else ACTIONS:
                for criteria in getattr(rule, action):
                    if criteria.partitions:
                        yield document.at(
                            criteria.line, "the topics are denied in every partition, not only in"
                            f" {_some(criteria.partitions)}",
                        )  # fmt: skip


def _some(words: tuple[str, ...]) -> str:
    """The first three, and how many more there are."""
    rest = f" and {len(words) - 3} more" if len(words) > 3 else ""  # noqa: PLR2004 -- a few
    return ", ".join(ascii(word)[1:-1] for word in words[:3]) + rest


@lint_rule(
    "PQS273", WARNING, "partitions that OpenDDS does not check",
    why="In OpenDDS, an allow_rule with partitions also applies to an endpoint without a"
    " partition.",
    fix="Do not use partitions to separate participants with OpenDDS; use other topics.",
    stacks={Stack.OPENDDS: "3.34"}, measured="read in OpenDDS 3.34's source", only_when_asked=True,
    rows=("allow partition P, endpoint in none",),
    bad="""
        <publish>
          <topics><topic>rt/chatter</topic></topics>
          <partitions><partition>floor1</partition></partitions>
        </publish>
    """,
    good="""
        <publish>
          <topics><topic>rt/floor1/chatter</topic></topics>
        </publish>
    """,
)  # fmt: skip
def partitions_not_asked(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule, _, criteria in criteria_of(grant):
            if rule.allow and criteria.partitions:
                yield document.at(
                    criteria.line, "OpenDDS also allows this to endpoints without a partition"
                )


@lint_rule(
    "PQS275", WARNING, "a partition that an endpoint can avoid with wildcards",
    why="Partitions of endpoints can have wildcards too, and stacks check only their names. floor?"
    " matches the name floor*, and an endpoint in floor* receives what is sent in floor12. The"
    " plugin of pqsec and `pqsec explain` check everything that the wildcards can match.",
    fix="Write full names, or a prefix with one * at the end: these work in all stacks.",
    stacks={Stack.CYCLONEDDS: "0.10.2", Stack.FASTDDS: "2.9.1", Stack.OPENDDS: ""},
    measured="Cyclone DDS 0.10.2, with running participants; the access control of Fast DDS 2.9.1;"
    " OpenDDS by source",
    bad="""
        <publish>
          <topics><topic>rt/chatter</topic></topics>
          <partitions><partition>floor[12]</partition></partitions>
        </publish>
    """,
    good="""
        <publish>
          <topics><topic>rt/chatter</topic></topics>
          <partitions><partition>floor*</partition></partitions>
        </publish>
    """,
)  # fmt: skip
def covers_expressions(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule, _, criteria in criteria_of(grant):
            for partition in criteria.partitions if rule.allow else ():
                if _INNER_WILDCARD.search(partition):
                    yield document.at(
                        criteria.line, f"{partition[:60]!a}: stacks allow endpoints whose wildcards"
                        " match more than this",
                    )  # fmt: skip
