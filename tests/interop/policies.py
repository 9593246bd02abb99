"""Policies and questions made up to tell readings apart, the same for the same seed.

Names are few and alike, so that patterns meet, miss and shadow each other.
"""

import random
from datetime import UTC, datetime, timedelta
from itertools import product

from pqsec_pki.access import Action, Interpretation, Question
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainRule,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
    ProtectionKind,
    TopicRule,
)

DOMAINS = (0, 1, 5)
TOPICS = ("a", "ab", "aab", "rt/a", "rt/]", "-b", "*", "[a]", "DCPSTopic")
TOPIC_PATTERNS = (
    *TOPICS,
    *("*b", "a*", "?b", "*/*", "*a*b", "**", "a?*", "{a,ab}", "\\*", "rt/\\a"),
    *("[ab]", "[!a]b", "[^a]b", "rt/[a-c]", "[a-b]b", "[a]-b", "[!]a]b", "[a]*"),
    *("[a", "[]a]", "[!]", "[a-]b", "[b-a]*", "rt/[[:alpha:]]", "rt/[]-a]"),
)
PARTITIONS = ((), ("",), ("P",), ("P", "Q"), ("", "P"), ("PQ",), ("*",))
PARTITION_PATTERNS = ("", "P", "Q", "*", "P*", "?", "[!P]", "[^P]", "[PQ]", "[P-")
EVERYWHERE = DomainSet.of(DomainRange(first=0, last=230))
_DAY = timedelta(days=1)


class Maker:
    """Makes policies by chance."""

    def __init__(self, seed: int) -> None:
        self._chance = random.Random(seed)  # noqa: S311 -- the same policies every time
        self._now = datetime.now(UTC)

    def governance(self) -> Governance:
        """Mostly one rule for all domains, with access control and join access control."""
        rules = self._some(self._domain_rule, 1, 2)
        return Governance(domain_rules=rules)

    def permissions(self, subject: str) -> Permissions:
        """One grant or a few, mostly for `subject` and in force."""
        return Permissions(grants=self._some(lambda: self._grant(subject), 1, 3))

    def _one(self, *choices):
        return self._chance.choice(choices)

    def _some(self, make, least, most):
        return tuple(make() for _ in range(self._chance.randint(least, most)))

    def _mostly(self) -> bool:
        return self._chance.random() < 0.8

    def _evenly(self) -> bool:
        return self._chance.random() < 0.5

    def _domains(self) -> DomainSet:
        return EVERYWHERE if self._mostly() else DomainSet(parts=self._some(self._part, 1, 2))

    def _part(self) -> int | DomainRange:
        first, last = self._one(*DOMAINS, 2, 230), self._one(None, None, 0, 1, 4, 5, 230)
        if self._evenly() or (last is not None and last < first):
            return first
        return DomainRange(first=first, last=last)

    def _domain_rule(self) -> DomainRule:
        kind = self._one(*ProtectionKind)
        return DomainRule(
            domains=self._domains(),
            allow_unauthenticated_participants=False,
            enable_join_access_control=self._mostly(),
            discovery_protection_kind=kind,
            liveliness_protection_kind=kind,
            rtps_protection_kind=kind,
            topic_rules=(*self._some(self._topic_rule, 0, 2), self._topic_rule("*")),
        )

    def _topic_rule(self, expression: str = "") -> TopicRule:
        return TopicRule(
            topic_expression=expression if self._mostly() and expression else self._topic(),
            enable_discovery_protection=self._mostly(),
            enable_liveliness_protection=self._mostly(),
            enable_read_access_control=self._mostly(),
            enable_write_access_control=self._mostly(),
            metadata_protection_kind=self._one(*ProtectionKind),
            data_protection_kind=ProtectionKind.SIGN,
        )

    def _topic(self) -> str:
        return self._one(*TOPIC_PATTERNS)

    def _criteria(self) -> Criteria:
        return Criteria(
            topics=self._some(self._topic, 1, 3),
            partitions=self._some(lambda: self._one(*PARTITION_PATTERNS), 0, 2),
            data_tags=self._some(lambda: ("kind", "test"), 0, 1),
        )

    def _rule(self) -> PermissionRule:
        return PermissionRule(
            allow=self._evenly() or self._evenly(),
            domains=self._domains(),
            publish=self._some(self._criteria, 0, 2),
            subscribe=self._some(self._criteria, 0, 2),
            relay=self._some(self._criteria, 0, 1),
        )

    def _grant(self, subject: str) -> Grant:
        current = self._mostly()
        late = self._evenly()
        return Grant(
            name="g",
            subject_name=subject if self._mostly() else "CN=/other",
            not_before=self._now + (_DAY if late and not current else -2 * _DAY),
            not_after=self._now + (-_DAY if not late and not current else 2 * _DAY),
            rules=self._some(self._rule, 0, 5),
            default=self._one(*DefaultAction),
        )


def questions(subject: str, domain: int, interpretation: Interpretation) -> list[Question]:
    """All there are on that domain; about relaying only if the stack knows of it."""
    asked = {"subject": subject, "domain": domain, "now": datetime.now(UTC)}
    actions = [Action.PUBLISH, Action.SUBSCRIBE] + [Action.RELAY] * interpretation.knows_relay
    return [Question(action=Action.JOIN, **asked)] + [
        Question(action=action, topic=topic, partitions=partitions, **asked)
        for action, topic, partitions in product(actions, TOPICS, PARTITIONS)
    ]
