"""Who may publish and subscribe to what: many participants, many topics."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._index import Names
from pqsec_pki.access._witnesses import is_wildcard, sample
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.interpretation import Interpretation
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.question import MAX_NAME, Action, Question
from pqsec_pki.documents import Criteria, Governance, Permissions

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
        topic
        for each in members
        for grant in each.permissions.grants
        for rule in grant.rules
        for criteria in (*rule.publish, *rule.subscribe)
        for topic in criteria.topics
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
        self._now, self._covers = now, interpretation.covers
        # No topic of DDS is longer, so nobody may use it.
        self._known = Names(name for name in names if name and len(name) <= MAX_NAME)
        rules = [each for rule in governance.domain_rules for each in rule.topic_rules]
        expressions = tuple(dict.fromkeys(each.topic_expression for each in rules))
        self._kind: dict[str, object] = {}
        """Governance treats topics of one kind alike on every domain: the same rules cover them."""
        self._of_kind: dict[object, list[str]] = {}
        for name in self._known.sorted:
            covered = tuple(interpretation.governs(each, name) for each in expressions)
            kind = covered, name in interpretation.builtin
            self._kind[name] = kind
            self._of_kind.setdefault(kind, []).append(name)
        self._members = [
            (each, InterpretedPolicy(governance, each.permissions, interpretation))
            for each in members
        ]

    def users(self, domain: int) -> TopicUsers:
        """Who may use which of the topics on that domain, with the members in their order."""
        publishers: dict[str, list[str]] = {}
        subscribers: dict[str, list[str]] = {}
        for member, policy in self._members:
            join = Question(
                subject=member.subject, domain=domain, action=Action.JOIN, now=self._now
            )
            for action, topic in self._uses(member, policy, join) if policy.joins(join) else ():
                found = publishers if action is Action.PUBLISH else subscribers
                found.setdefault(topic, []).append(member.name)
        return TopicUsers(publishers, subscribers)

    def _uses(
        self, member: DocumentOwner, policy: InterpretedPolicy, join: Question
    ) -> Iterator[tuple[Action, str]]:
        """The topics that this member may use, each with its action.

        A decision depends only on which patterns cover the topic. So one topic is asked about for
        all that governance treats alike and that the same criteria cover.
        """
        covering, alike = self._covering(member), dict[object, list[str]]()
        for name, numbers in covering.items():
            alike.setdefault((self._kind[name], numbers), []).append(name)
        own = {names[0]: names for names in alike.values()}
        others = dict[str, list[str]]()
        for names in self._of_kind.values():
            if first := next((name for name in names if name not in covering), None):
                others[first] = names
        for action, first in policy.uses(join, (*own, *others)):
            names = own.get(first) or [each for each in others[first] if each not in covering]
            yield from ((action, name) for name in names)

    def _covering(self, member: DocumentOwner) -> dict[str, tuple[int, ...]]:
        """The topics that this member's criteria cover, each with the numbers of those criteria."""
        found: dict[str, tuple[int, ...]] = {}
        for number, criteria in enumerate(_criteria(member)):
            covered = (self._known.covered(each, self._covers) for each in criteria.topics)
            for name in frozenset[str]().union(*covered):
                found[name] = (*found.get(name, ()), number)
        return found


def _criteria(member: DocumentOwner) -> Iterator[Criteria]:
    for grant in member.permissions.grants:
        for rule in grant.rules:
            yield from (*rule.publish, *rule.subscribe, *rule.relay)
