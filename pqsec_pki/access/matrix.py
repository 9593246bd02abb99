"""Who may publish and subscribe to what: many participants, many topics."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timedelta

from pqsec_pki._dataclass import dataclass
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
_EITHER = (Action.PUBLISH, Action.SUBSCRIBE)
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
    named = {
        topic for each in members for action in _EITHER for topic in _own_patterns(each, action)
    }
    return tuple(sorted(named - {""}))


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
    asked = samples(members, topics, asked)
    matrix = Matrix(governance, members, asked.values(), now=now, interpretation=interpretation)
    users = matrix.users(domain)
    return tuple(users.row(topic, name) for topic, name in asked.items())


def samples(
    members: Iterable[DocumentOwner], topics: Iterable[str], asked: Mapping[str, str | None]
) -> dict[str, str | None]:
    """For each topic itself, and for each pattern a topic that it covers: that of `asked`."""
    wanted = tuple(dict.fromkeys(topics))
    literals = frozenset((*wanted, *topics_named(members)))
    return {topic: asked[topic] if topic in asked else sample(topic, literals) for topic in wanted}


@dataclass(frozen=True, slots=True)
class TopicUsers:
    """Who may use each topic on a domain: only topics that anybody may use."""

    publishers: Mapping[str, list[str]]
    subscribers: Mapping[str, list[str]]

    def row(self, topic: str, asked: str | None) -> TopicRow:
        """The row of the topic, or of a pattern with its sample topic."""
        return TopicRow(
            topic=topic,
            asked=asked,
            publishers=tuple(self.publishers.get(asked or "", ())),
            subscribers=tuple(self.subscribers.get(asked or "", ())),
        )


class Matrix:
    """Many participants and topics, for questions about one domain after another."""

    def __init__(
        self,
        governance: Governance,
        members: Iterable[DocumentOwner],
        names: Iterable[str | None],
        *,
        now: datetime,
        interpretation: Interpretation,
    ) -> None:
        self._governance, self._interpretation, self._now = governance, interpretation, now
        self._known = Names(name for name in names if name)
        governs, builtin = interpretation.governs, interpretation.builtin
        rules = [each for rule in governance.domain_rules for each in rule.topic_rules]
        expressions = tuple(dict.fromkeys(each.topic_expression for each in rules))
        self._alike: dict[object, list[str]] = {}
        """Topics that governance treats alike on every domain: the same topic rules cover them."""
        for name in self._known.sorted:
            covered = tuple(governs(each, name) for each in expressions)
            self._alike.setdefault((covered, name in builtin), []).append(name)
        self._members = [
            (each, InterpretedPolicy(governance, each.permissions, interpretation))
            for each in members
        ]

    def users(self, domain: int) -> TopicUsers:
        """Who may use which of the topics on that domain, with the members in their order."""
        publishers: dict[str, list[str]] = {}
        subscribers: dict[str, list[str]] = {}
        open_to_all = self._open(domain)
        for member, policy in self._members:
            join = self._question(member.subject, domain)
            topics = {action: self._worth_asking(member, action, open_to_all) for action in _EITHER}
            for action, topic in policy.uses(join, topics):
                found = publishers if action is Action.PUBLISH else subscribers
                found.setdefault(topic, []).append(member.name)
        return TopicUsers(publishers, subscribers)

    def _question(self, subject: str, domain: int) -> Question:
        return Question(subject=subject, domain=domain, action=Action.JOIN, now=self._now)

    def _worth_asking(
        self, member: DocumentOwner, action: Action, open_to_all: frozenset[str]
    ) -> Iterator[str]:
        """The topics that this member's rules, default or the governance may allow."""
        if any(grant.default is DefaultAction.ALLOW for grant in member.permissions.grants):
            yield from self._known.sorted
            return
        covers = self._interpretation.covers
        found = (self._known.covered(each, covers) for each in _own_patterns(member, action))
        yield from sorted(open_to_all.union(*found))

    def _open(self, domain: int) -> frozenset[str]:
        """The topics that every member may use, because governance does not control them."""
        day = timedelta(days=1)
        grant = Grant(
            name=_ANYONE,
            subject_name=_ANYONE,
            not_before=self._now - day,
            not_after=self._now + day,
            rules=(PermissionRule(allow=True, domains=DomainSet(parts=(domain,))),),
        )
        policy = InterpretedPolicy(
            self._governance, Permissions(grants=(grant,)), self._interpretation
        )
        groups, join = self._alike.values(), self._question(_ANYONE, domain)
        firsts = {action: [names[0] for names in groups] for action in _EITHER}
        found = {name for _, name in policy.uses(join, firsts)}
        return frozenset(name for names in groups if names[0] in found for name in names)


def _own_patterns(member: DocumentOwner, action: Action) -> Iterator[str]:
    for grant in member.permissions.grants:
        for rule in grant.rules:
            for criteria in rule.publish if action is Action.PUBLISH else rule.subscribe:
                yield from criteria.topics
