"""The topics that one participant may publish and another may subscribe to.

Two participants can authenticate each other without having such a topic.
"""

from collections.abc import Iterable, Iterator
from datetime import datetime
from functools import lru_cache
from itertools import product
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._patterns import posix
from pqsec_pki.access._witnesses import is_wildcard, sample, witnesses
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.interpretation import Viewpoint
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    Governance,
    PermissionRule,
    Permissions,
    TopicRule,
    ros,
)

_CACHED = 1 << 12
"""Pairs of patterns in the cache; a fleet has few roles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantDocuments:
    """A participant's subject, with its two documents."""

    subject: str
    governance: Governance
    permissions: Permissions

    def criteria(self, action: Action, domain: int) -> list[Criteria]:
        """The criteria, of any of its grants, that may allow the action on the domain."""
        rules = (rule for rule in self._rules(domain) if rule.allow)
        return [
            each
            for rule in rules
            for each in (rule.publish if action is Action.PUBLISH else rule.subscribe)
        ]

    def topics(self, action: Action, domain: int) -> list[str]:
        """Topics and patterns that a rule, a default or the governance may allow on the domain."""
        found = [topic for each in self.criteria(action, domain) for topic in each.topics]
        for rule in self._topic_rules(domain):
            writing, interpretation = (
                rule.enable_write_access_control,
                rule.enable_read_access_control,
            )
            if not (writing if action is Action.PUBLISH else interpretation):
                found.append(rule.topic_expression)
        if any(grant.default is DefaultAction.ALLOW for grant in self.permissions.grants):
            found.append("*")
        return list(dict.fromkeys(found))

    def limits(self, domain: int) -> Iterator[str]:
        """Patterns that distinguish topics which another pattern covers."""
        for rule in self._rules(domain):
            for each in () if rule.allow else (*rule.publish, *rule.subscribe):
                yield from each.topics
        yield from (rule.topic_expression for rule in self._topic_rules(domain))

    def _rules(self, domain: int) -> Iterator[PermissionRule]:
        for grant in self.permissions.grants:
            yield from (rule for rule in grant.rules if domain in rule.domains)

    def _topic_rules(self, domain: int) -> tuple[TopicRule, ...]:
        rule = self.governance.rule_for(domain)
        return rule.topic_rules if rule else ()


def topics_between(
    publisher: ParticipantDocuments, subscriber: ParticipantDocuments, *, domain: int, now: datetime
) -> tuple[str, ...]:
    """What one may publish and the other may subscribe to, by the standard.

    Each is a topic, a pattern that both have, or, for two different patterns, a topic that both
    cover. The discovery topic of ROS 2 is left out: all nodes share it.
    """
    sending = _End.of(publisher, subscriber, Action.PUBLISH, domain, now)
    receiving = _End.of(subscriber, publisher, Action.SUBSCRIBE, domain, now)
    partitions = tuple(dict.fromkeys((*sending.partitions, *receiving.partitions)))

    def shared(topic: str) -> bool:
        return any(sending.may(topic, each) and receiving.may(topic, each) for each in partitions)

    limits = tuple(dict.fromkeys((*publisher.limits(domain), *subscriber.limits(domain))))
    found: dict[str, None] = {}
    for one, other in product(sending.topics, receiving.topics):
        names = (name for name in _of_both(one, other, limits) if name != ros.DISCOVERY)
        if name := next(filter(shared, names), None):
            found[one if one == other else name] = None
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class _End:
    """One of two participants: what its own stack and its peer allow it."""

    subject: str
    action: Action
    domain: int
    now: datetime
    topics: list[str]
    partitions: tuple[tuple[str, ...], ...]
    tags: tuple[tuple[tuple[str, str], ...], ...]
    judges: tuple[tuple[Viewpoint, InterpretedPolicy], ...]

    @classmethod
    def of(
        cls,
        own: ParticipantDocuments,
        peer: ParticipantDocuments,
        action: Action,
        domain: int,
        now: datetime,
    ) -> Self:
        """The rights of `own`, with the default partition and no data tags first."""
        criteria = own.criteria(action, domain)
        names = (sample(name) for each in criteria for name in each.partitions)
        return cls(
            subject=own.subject,
            action=action,
            domain=domain,
            now=now,
            topics=own.topics(action, domain),
            partitions=tuple(dict.fromkeys([(), *((name,) for name in names if name)])),
            tags=tuple(dict.fromkeys([(), *(each.data_tags for each in criteria)])),
            judges=(
                (Viewpoint.OWN, InterpretedPolicy(own.governance, own.permissions)),
                (Viewpoint.PEER, InterpretedPolicy(peer.governance, own.permissions)),
            ),
        )

    def may(self, topic: str, partitions: tuple[str, ...]) -> bool:
        """Whether an endpoint with the topic and partitions is allowed with some data tags."""
        return any(self._may(topic, partitions, tags) for tags in self.tags)

    def _may(
        self, topic: str, partitions: tuple[str, ...], tags: tuple[tuple[str, str], ...]
    ) -> bool:
        question = Question(
            subject=self.subject,
            domain=self.domain,
            action=self.action,
            now=self.now,
            topic=topic,
            partitions=partitions,
            data_tags=tags,
        )
        return all(policy.decide(question, by=side).allowed for side, policy in self.judges)


def _of_both(one: str, other: str, limits: tuple[str, ...]) -> Iterable[str]:
    """Topics that both patterns cover: one for each set of `limits` that can cover a topic."""
    if not is_wildcard(one) or not is_wildcard(other):
        literal, pattern = (other, one) if is_wildcard(one) else (one, other)
        return (literal,) if posix(pattern, literal) else ()
    return _met(one, other, limits)


@lru_cache(_CACHED)
def _met(one: str, other: str, limits: tuple[str, ...]) -> tuple[str, ...]:
    found = witnesses((one, other, *limits)).names
    return tuple(name for name in found if posix(one, name) and posix(other, name))
