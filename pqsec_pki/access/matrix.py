"""Who may publish and subscribe to what: many participants, many topics."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from datetime import datetime
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._index import Names
from pqsec_pki.access._topics import Topics
from pqsec_pki.access._witnesses import is_wildcard, sample
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.interpretation import Interpretation
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.question import MAX_NAME, Action, Question
from pqsec_pki.documents import Criteria, Governance, Grant, PermissionRule, Permissions

_NOTHING: Mapping[str, str | None] = {}
_Kind: TypeAlias = int
_Covering: TypeAlias = tuple[int, ...]
"""The numbers of the criteria of a grant that cover a topic."""


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
    if possible one that no rule names; None if none was found. `asked_in` are the partitions of
    that question, empty for the default partition. The answer holds in each of `partitions`; if
    the question was about several partitions, in all of them together.
    """

    topic: str
    asked: str | None
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    partitions: tuple[Topics, ...] = ()
    asked_in: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        """The partitions in words; empty for the default partition."""
        if not self.asked_in:
            return ""
        joined = " and " if len(self.asked_in) > 1 else ", "
        return joined.join(each.short or "(default)" for each in self.partitions)

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
    return tuple(
        TopicRow(topic=topic, asked=name, publishers=publishers, subscribers=subscribers)
        for topic, name in asked.items()
        for publishers, subscribers in [users.of(name or "")]
    )


def samples(
    members: Iterable[DocumentOwner], topics: Iterable[str], asked: Mapping[str, str | None]
) -> dict[str, str | None]:
    """Topic -> itself, pattern -> a topic that it covers; the value in `asked` has precedence."""
    wanted = tuple(dict.fromkeys(topics))
    literals = frozenset((*wanted, *topics_named(members)))
    return {topic: asked[topic] if topic in asked else sample(topic, literals) for topic in wanted}


@dataclass(frozen=True, slots=True)
class TopicUsers:
    """The participants that may use each topic on a domain, without topics that no one may use."""

    publishers: dict[str, list[str]]
    subscribers: dict[str, list[str]]

    @property
    def topics(self) -> Iterable[str]:
        """The topics, each once."""
        return self.publishers | self.subscribers

    def add(self, name: str, uses: Iterable[tuple[tuple[Action, ...], Iterable[str]]]) -> None:
        """Add a participant, by the result of `Matrix.uses`."""
        for actions, topics in uses:
            for action in actions:
                found = self.publishers if action is Action.PUBLISH else self.subscribers
                for topic in topics:
                    found.setdefault(topic, []).append(name)

    def of(self, topic: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Who may publish the topic, and who may subscribe to it."""
        return tuple(self.publishers.get(topic, ())), tuple(self.subscribers.get(topic, ()))


@dataclass(slots=True)
class MatrixMember:
    """A participant with the grant that applies to it."""

    name: str
    policy: InterpretedPolicy
    join: Question
    grant: Grant
    outline: int
    """A number that is equal for grants that differ only in names: no decision depends on those."""
    covering: dict[str, _Covering] | None = None
    """The topics that its criteria cover, each with the numbers of those criteria."""
    alike: dict[tuple[_Kind, _Covering], list[str]] = field(default_factory=dict)
    """The topics of one kind that the same criteria cover."""


class Matrix:
    """Many participants and topics, for questions about one domain after another.

    A decision depends on a topic only by the patterns that cover it. So one topic is asked about
    for all that governance treats alike and that the same criteria cover; and one participant for
    all whose grants differ only in the names of topics.
    """

    def __init__(
        self,
        governance: Governance,
        members: Iterable[DocumentOwner],
        names: Iterable[str | None],
        *,
        now: datetime,
        interpretation: Interpretation,
    ) -> None:
        self._now, self.interpretation = now, interpretation
        # RTPS allows no longer topic: there is no answer for one.
        self._known = Names(name for name in names if name and len(name) <= MAX_NAME)
        rules = [each for rule in governance.domain_rules for each in rule.topic_rules]
        expressions = tuple(dict.fromkeys(each.topic_expression for each in rules))
        self._kind: dict[str, _Kind] = {}
        """Governance treats topics of one kind alike on every domain: the same rules cover them."""
        kinds: dict[object, _Kind] = {}
        self._of_kind: dict[_Kind, list[str]] = {}
        for name in self._known.sorted:
            covered = tuple(interpretation.governs(each, name) for each in expressions)
            kind = kinds.setdefault((covered, name in interpretation.builtin), len(kinds))
            self._kind[name] = kind
            self._of_kind.setdefault(kind, []).append(name)
        self._joins: dict[object, bool] = {}
        self._actions: dict[object, tuple[Action, ...]] = {}
        self.members = list(self._applicable(governance, members))

    def _applicable(
        self, governance: Governance, owners: Iterable[DocumentOwner]
    ) -> Iterator[MatrixMember]:
        """The participants to which a grant applies; the others have no rights."""
        outlines: dict[object, int] = {}
        for each in owners:
            policy = InterpretedPolicy(governance, each.permissions, self.interpretation)
            join = Question(subject=each.subject, domain=0, action=Action.JOIN, now=self._now)
            if grant := policy.grant(join):
                is_in_force = self.interpretation.in_force(grant, self._now)
                outline = is_in_force, grant.default, tuple(map(_outline, grant.rules))
                number = outlines.setdefault(outline, len(outlines))
                yield MatrixMember(each.name, policy, join, grant, number)

    def users(self, domain: int, partitions: tuple[str, ...] = ()) -> TopicUsers:
        """Who may use which of the topics on that domain, with the members in their order.

        With endpoints that are in all of these partitions, or in the default partition.
        """
        found = TopicUsers({}, {})
        for member in self.members:
            found.add(member.name, self.uses(member, domain, partitions))
        return found

    def uses(
        self, member: MatrixMember, domain: int, partitions: tuple[str, ...]
    ) -> Iterator[tuple[tuple[Action, ...], Iterable[str]]]:
        """Pairs of actions and the topics for which this member may do them."""
        key = member.outline, domain
        if key not in self._joins:
            self._joins[key] = member.policy.joins(replace(member.join, domain=domain))
        if not self._joins[key]:
            return
        covering = self._covering(member)
        for (kind, numbers), names in member.alike.items():
            if actions := self._allowed(member, (domain, partitions), kind, numbers, names):
                yield actions, names
        for kind, names in self._of_kind.items():
            if actions := self._allowed(member, (domain, partitions), kind, (), names):
                yield actions, [name for name in names if name not in covering]

    def _allowed(
        self,
        member: MatrixMember,
        place: tuple[int, tuple[str, ...]],
        kind: _Kind,
        numbers: _Covering,
        names: Iterable[str],
    ) -> tuple[Action, ...]:
        """The allowed actions of such a member for such topics; `names` has some, and others."""
        key = member.outline, place, kind, numbers
        if key not in self._actions:
            covering = self._covering(member)
            one = next((name for name in names if covering.get(name, ()) == numbers), None)
            if one is None:
                return ()  # there is no such topic
            join = replace(member.join, domain=place[0], partitions=place[1])
            self._actions[key] = tuple(action for action, _ in member.policy.uses(join, [one]))
        return self._actions[key]

    def _covering(self, member: MatrixMember) -> dict[str, _Covering]:
        """The topics that this member's criteria cover; it also groups them."""
        if member.covering is None:
            found: dict[str, _Covering] = {}
            for number, criteria in enumerate(criteria_of(member.grant)):
                for name in self._known.covered_by(criteria.topics, self.interpretation.covers):
                    found[name] = (*found.get(name, ()), number)
            for name, numbers in found.items():
                member.alike.setdefault((self._kind[name], numbers), []).append(name)
            member.covering = found
        return member.covering


def criteria_of(grant: Grant) -> Iterator[Criteria]:
    """All criteria of its rules."""
    for rule in grant.rules:
        yield from (*rule.publish, *rule.subscribe, *rule.relay)


def _outline(rule: PermissionRule) -> object:
    """The rule without its topics."""
    limits = (
        tuple((each.partitions, each.data_tags) for each in criteria)
        for criteria in (rule.publish, rule.subscribe, rule.relay)
    )
    return rule.allow, rule.domains, *limits
