"""What ends the process of a stack that reads it, although the schema allows it.

Signing refuses what the table has, and each interpretation of the documents answers `crashes`.
Rules of lint report the same (PQS218, PQS232), with versions of their own.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents.domains import DomainRange
from pqsec_pki.problems import Problem
from pqsec_pki.stacks import Stack

if TYPE_CHECKING:
    from pqsec_pki.documents.governance import DomainRule, TopicRule
    from pqsec_pki.documents.permissions import Criteria, Grant, PermissionRule

    Part: TypeAlias = PermissionRule | TopicRule

_XML_SPACE = " \t\r\n"
_CYCLONES = ("0.10.2", "0.10.5", "11.0.1")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CrashShape:
    """Content that crashes stacks."""

    what: str
    fix: str
    versions: Mapping[Stack, tuple[str, ...]]
    """The versions of each stack whose process ended when it was tried."""

    def crashes(self, stack: str, version: str = "") -> bool:
        """Whether it crashes this stack in a version such as 11.0; without one, in any version."""
        known = {each.value: found for each, found in self.versions.items()}.get(stack, ())
        return any(f"{each}.".startswith(f"{version}." if version else "") for each in known)

    @property
    def stacks(self) -> str:
        """The stacks and versions: `Cyclone DDS 0.10.2, 11.0.1 and Fast DDS 2.9.1`."""
        return " and ".join(
            f"{stack.product} {', '.join(found)}" for stack, found in self.versions.items()
        )


RANGE_WITHOUT_MIN = CrashShape(
    what="a range of domains without <min> in permissions",
    fix="write <min>0</min>",
    versions={Stack.CYCLONEDDS: _CYCLONES},
)
"""Cyclone DDS follows a null pointer to compare domains (`domainid_within_sets`)."""
EMPTY_TOPIC = CrashShape(
    what="an empty <topic> to publish or subscribe",
    fix="write the topic, or * for all topics",
    versions={Stack.CYCLONEDDS: _CYCLONES},
)
"""Cyclone DDS matches a null pointer (`is_topic_in_criteria`); it ignores <relay>."""
EMPTY_EXPRESSION = CrashShape(
    what="an empty <topic_expression>",
    fix="write the topic, or * for all topics",
    versions={Stack.CYCLONEDDS: _CYCLONES, Stack.FASTDDS: ("2.9.1", "3.1.2")},
)
"""Cyclone DDS matches a null pointer, and Fast DDS makes a string of one."""

CRASH_SHAPES = (RANGE_WITHOUT_MIN, EMPTY_TOPIC, EMPTY_EXPRESSION)


@dataclass(frozen=True, slots=True)
class Crash:
    """A place in a document that crashes stacks."""

    shape: CrashShape
    part: "Part"
    """The rule that has it."""
    criteria: "Criteria | None" = None

    @property
    def problem(self) -> Problem:
        """For who would sign it, with the line of the rule or its criteria."""
        words = f"{self.shape.what} crashes {self.shape.stacks}; {self.shape.fix}"
        return Problem(words, line=(self.criteria or self.part).line)


def governance_crashes(rules: "Iterable[DomainRule]") -> Iterator[Crash]:
    """What crashes stacks in the domain rules of a governance document."""
    for rule in rules:
        for topic_rule in rule.topic_rules:
            if is_blank(topic_rule.topic_expression):
                yield Crash(EMPTY_EXPRESSION, topic_rule)


def grant_crashes(grants: "Iterable[Grant]") -> Iterator[Crash]:
    """What crashes stacks in these grants."""
    for grant in grants:
        for rule in grant.rules:
            if any(isinstance(each, DomainRange) and each.no_min for each in rule.domains.parts):
                yield Crash(RANGE_WITHOUT_MIN, rule)
            for criteria in (*rule.publish, *rule.subscribe):
                if any(map(is_blank, criteria.topics)):
                    yield Crash(EMPTY_TOPIC, rule, criteria)


def is_blank(value: str) -> bool:
    """Whether it has nothing but white space, which stacks drop."""
    return not value.strip(_XML_SPACE)
