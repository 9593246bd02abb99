"""Who may publish and subscribe to what: many participants, many topics."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from pqsec_pki.access._index import Names
from pqsec_pki.access._witnesses import is_wildcard, sample
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.interpretation import Interpretation
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import (
    DefaultAction,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
)

_ANYONE = "CN=anyone"
_NOTHING: Mapping[str, str | None] = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentOwner:
    """A participant and its permissions document."""

    name: str
    subject: str
    permissions: Permissions


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRow:
    """Who may use a topic, by name.

    For a pattern, `asked` is the topic that the question was about: one that the pattern covers,
    if possible one that no rule names; None if none was found.
    """

    topic: str
    asked: str | None
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]

    @property
    def is_pattern(self) -> bool:
        """Whether `topic` is a pattern of several topics."""
        return is_wildcard(self.topic)


def topics_named(members: Iterable[DocumentOwner]) -> tuple[str, ...]:
    """All topics and patterns for publishing and subscribing in any rule, sorted."""
    return tuple(sorted({topic for each in members for topic in _own_patterns(each)} - {""}))


def who_may(  # noqa: PLR0913 -- what is asked, by name
    governance: Governance,
    members: Sequence[DocumentOwner],
    topics: Iterable[str],
    *,
    domain: int,
    now: datetime,
    interpretation: Interpretation = SPEC,
    asked: Mapping[str, str | None] = _NOTHING,
) -> tuple[TopicRow, ...]:
    """A row for each topic, with the members in their order.

    `asked` has a sample topic for each pattern; for a pattern that is not in it, one is generated.

    For each member only topics are checked that its rules or the governance may allow, so a
    thousand members take seconds.
    """
    wanted = tuple(dict.fromkeys(topics))
    literals = frozenset((*wanted, *topics_named(members)))
    asked = {topic: asked[topic] if topic in asked else sample(topic, literals) for topic in wanted}
    names = [name for name in asked.values() if name]
    may = _Asking(governance, interpretation, domain, now)
    publishers: dict[str, list[str]] = {name: [] for name in names}
    subscribers: dict[str, list[str]] = {name: [] for name in names}
    index = _Index(names, interpretation, may.everyone(names))
    for member in members:
        policy = InterpretedPolicy(governance, member.permissions, interpretation)
        for topic in index.worth_asking(member):
            for action, found in ((Action.PUBLISH, publishers), (Action.SUBSCRIBE, subscribers)):
                if may.do(policy, member.subject, action, topic):
                    found[topic].append(member.name)
    return tuple(
        TopicRow(
            topic=topic,
            asked=name,
            publishers=tuple(publishers.get(name or "", ())),
            subscribers=tuple(subscribers.get(name or "", ())),
        )
        for topic, name in asked.items()
    )


@dataclass(frozen=True, slots=True)
class _Asking:
    """The values that all questions share."""

    governance: Governance
    interpretation: Interpretation
    domain: int
    now: datetime

    def do(self, policy: InterpretedPolicy, subject: str, action: Action, topic: str) -> bool:
        """Whether `policy` allows the action with the topic."""
        question = Question(
            subject=subject, domain=self.domain, action=action, now=self.now, topic=topic
        )
        return policy.decide(question).allowed

    def everyone(self, topics: Iterable[str]) -> frozenset[str]:
        """Those of `topics` that every member may use, because governance does not control them."""
        rule = PermissionRule(allow=True, domains=DomainSet(parts=(self.domain,)))
        day = timedelta(days=1)
        grant = Grant(
            name=_ANYONE,
            subject_name=_ANYONE,
            not_before=self.now - day,
            not_after=self.now + day,
            rules=(rule,),
        )
        policy = InterpretedPolicy(
            self.governance, Permissions(grants=(grant,)), self.interpretation
        )
        either = (Action.PUBLISH, Action.SUBSCRIBE)
        return frozenset(
            topic
            for topic in topics
            if any(self.do(policy, _ANYONE, action, topic) for action in either)
        )


class _Index:
    """The topics of all questions; finds those that a member may be allowed."""

    def __init__(
        self, names: Iterable[str], interpretation: Interpretation, free: frozenset[str]
    ) -> None:
        self._known = Names(names)
        self._interpretation = interpretation
        self._free = free

    def worth_asking(self, member: DocumentOwner) -> Iterable[str]:
        """The topics that this member's rules, default or the governance may allow."""
        if any(grant.default is DefaultAction.ALLOW for grant in member.permissions.grants):
            return self._known.sorted
        covers = self._interpretation.covers
        found = (self._known.covered(each, covers) for each in _own_patterns(member))
        return sorted(self._free.union(*found))


def _own_patterns(member: DocumentOwner) -> Iterator[str]:
    for grant in member.permissions.grants:
        for rule in grant.rules:
            for criteria in (*rule.publish, *rule.subscribe):
                yield from criteria.topics
