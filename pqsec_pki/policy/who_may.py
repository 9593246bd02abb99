"""Which participants may publish and subscribe to each topic."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import field, replace
from datetime import datetime
from itertools import chain, islice

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import (
    MAX_NAME,
    Action,
    DocumentOwner,
    Interpretation,
    InterpretedPolicy,
    Placed,
    Question,
    domains_ungoverned,
    is_known,
    topics_asked,
    topics_named,
    who_may_anywhere,
)
from pqsec_pki.documents import (
    DomainRange,
    DomainSet,
    governance_crashes,
    grant_crashes,
)
from pqsec_pki.errors import meant
from pqsec_pki.policy.fleet import Fleet
from pqsec_pki.policy.participants import end_of_rights

_PATTERN = re.compile(r"[*?\[]")


@dataclass(frozen=True, slots=True, kw_only=True)
class WhoMay:
    """The answer for some topics, or for all that the rules name."""

    fleet: Fleet
    domains: DomainSet | None
    """The domains that were asked about; None for all."""
    partitions: tuple[str, ...]
    """The partitions of the endpoint that was asked about. Empty for the default partition, with
    rows for rights that are only in others."""
    complete: bool
    """Whether all partitions that the rules distinguish were searched."""
    interpretation: Interpretation
    rows: list[Placed]
    unknown: dict[str, str]
    """Topics and patterns that no rule names or matches -> similar names as a text."""
    ungoverned: list[DomainRange]
    """The domains of `domains` that the governance does not name."""
    until: dict[str, datetime]
    """The end of each participant's rights: of its grant, its certificate or a CA."""
    unanswered: dict[str, str] = field(default_factory=dict)
    """Participants that are in no row because the answer is not known -> why, with the place."""
    others: "tuple[WhoMay, ...]" = ()
    """The answers by other versions of the stack."""

    @property
    def too_long(self) -> list[str]:
        """The topics that are longer than RTPS allows, for which there is no answer."""
        every = (each.row for each in self.rows)
        return [row.topic for row in every if len(row.topic) > MAX_NAME and not row.is_pattern]

    @property
    def crashes(self) -> dict[str, str]:
        """What crashes some stack, which, and where, beside what is not answered therefore: of each
        participant, and of the governance."""
        told = {name for each in (self, *self.others) for name in each.unanswered}
        of_all = () if told else governance_crashes(self.fleet.governance.domain_rules)
        found = [("governance", of_all)]
        found += [
            (member.name, grant_crashes(member.permissions.grants))
            for member in self.fleet.members
            if member.name not in told
        ]
        return {name: str(each.problem) for name, them in found for each in islice(them, 1)}

    def to_json(self) -> dict[str, object]:
        """With one object for each row."""
        return {
            "domains": None if self.domains is None else str(self.domains),
            "partitions": self.partitions,
            "complete": self.complete,
            "as": self.interpretation.name,
            "participants": [member.name for member in self.fleet.members],
            "until": self.until,
            "left_out": self.fleet.refused,
            "unanswered": self.unanswered,
            "crashes": self.crashes,
            "topics": list(self.rows_as_json()),
            "unknown_topics": self.unknown,
            "others": [
                {
                    "as": other.interpretation.name,
                    "unanswered": other.unanswered,
                    "differs": (differing := self.differing(other)),
                    "topics": [each for each in other.rows_as_json() if each["topic"] in differing],
                }
                for other in self.others
            ],
        }

    def differing(self, other: "WhoMay") -> list[str]:
        """The topics whose rows differ in another answer."""
        mine, theirs = _rows_by_topic(self.rows), _rows_by_topic(other.rows)
        return [topic for topic in mine | theirs if mine.get(topic) != theirs.get(topic)]

    def of(self, names: Collection[str]) -> "WhoMay":
        """Only the rows, also of the others, in which one of these participants is named."""
        return replace(
            self,
            rows=_rows_of(self.rows, names),
            unanswered={name: why for name, why in self.unanswered.items() if name in names},
            others=tuple(each.of(names) for each in self.others),
        )

    def rows_as_json(self) -> Iterator[dict[str, object]]:
        """One object for each row."""
        for each in self.rows:
            yield {
                "topic": each.row.topic,
                "domains": str(each.domains),
                "partitions": [one.to_json() for one in each.row.partitions],
                "pattern": each.row.is_pattern,
                "asked": each.row.asked,
                "publish": list(each.row.publishers),
                "subscribe": list(each.row.subscribers),
            }


def _rows_by_topic(rows: Iterable[Placed]) -> dict[str, list[Placed]]:
    found: dict[str, list[Placed]] = {}
    for each in rows:
        found.setdefault(each.row.topic, []).append(each)
    return found


def _rows_of(rows: Iterable[Placed], names: Iterable[str]) -> list[Placed]:
    """The rows in which one of these participants may publish or subscribe."""
    wanted = set(names)
    return [
        each
        for each in rows
        if not wanted.isdisjoint(each.row.publishers) or not wanted.isdisjoint(each.row.subscribers)
    ]


def who_may_use(  # noqa: PLR0913 -- what is asked, by name
    fleet: Fleet,
    topics: tuple[str, ...] = (),
    *,
    domains: DomainSet | None = None,
    partitions: tuple[str, ...] = (),
    now: datetime,
    interpretation: Interpretation,
) -> WhoMay:
    """Who may publish and subscribe to these DDS topics and patterns, on these domains.

    Without topics, to all that the rules name; without domains, on all. With partitions, as an
    endpoint that is in all of them; without, in the default partition, and in each other one in
    which somebody may what they may not there.
    """
    named = topics_named(fleet.members)
    asked = topics_asked(fleet.members, topics) if topics else dict[str, str | None]()
    placed = who_may_anywhere(
        fleet.governance,
        fleet.members,
        tuple(asked) if topics else named,
        domains=domains,
        partitions=partitions,
        now=now,
        interpretation=interpretation,
        asked=asked,
    )
    rows = list(placed.rows)
    # A pattern has its own row for topics that it matches and no rule names.
    beside = {topic for topic in topics if _PATTERN.search(topic)}.difference(named)
    used = [each for each in rows if each.is_used or each.row.topic not in beside]
    known = named if _may_all(fleet.members) else tuple(each for each in named if each != "*")
    unknown = (each for each in topics if each not in named and not is_known(each, known))
    return WhoMay(
        fleet=fleet,
        domains=domains,
        partitions=partitions,
        complete=placed.complete,
        interpretation=interpretation,
        rows=used or rows,
        unknown={topic: meant(topic, named) for topic in unknown},
        ungoverned=domains_ungoverned(fleet.governance, domains) if domains else [],
        until=dict(_ends(fleet, now, interpretation)),
        unanswered=dict(_unanswered(fleet, now, interpretation)),
    )


def _unanswered(
    fleet: Fleet, now: datetime, interpretation: Interpretation
) -> Iterator[tuple[str, str]]:
    """The participants whose documents crash the stack or are not read alike, and where."""
    for member in fleet.members:
        policy = InterpretedPolicy(fleet.governance, member.permissions, interpretation)
        join = Question(subject=member.subject, domain=0, action=Action.JOIN, now=now)
        if decision := policy.unanswered(join):
            known = fleet.inputs.get(member.name)
            place = known.place(decision) if known else None
            where = f" ({place[0]}:{place[1]})" if place else ""
            yield member.name, decision.reason + where


def who_may_by_each(  # noqa: PLR0913 -- what is asked, by name
    fleet: Fleet,
    topics: tuple[str, ...],
    *,
    domains: DomainSet | None,
    partitions: tuple[str, ...] = (),
    now: datetime,
    versions: Sequence[Interpretation],
) -> WhoMay:
    """The answer by the first version of a stack, with those by the others.

    Also with those in C.UTF-8, for topics about which the locale decides.
    """
    locales = [row for each in versions for row in each.locales[1:]]
    found, *others = (
        who_may_use(
            fleet, topics, domains=domains, partitions=partitions, now=now, interpretation=each
        )
        for each in (*versions, *(locales if _has_non_ascii(fleet, (*topics, *partitions)) else ()))
    )
    kept = [each for each in others if not each.interpretation.locale or found.differing(each)]
    return replace(found, others=tuple(kept))


def _has_non_ascii(fleet: Fleet, asked: Iterable[str]) -> bool:
    """Whether a name or pattern is not ASCII: else a locale decides nothing about these names."""
    rules = (rule for each in fleet.members for g in each.permissions.grants for rule in g.rules)
    criteria = (each for rule in rules for each in (*rule.publish, *rule.subscribe))
    partitions = (name for each in criteria for name in each.partitions)
    return not all(map(str.isascii, chain(asked, topics_named(fleet.members), partitions)))


def _ends(
    fleet: Fleet, now: datetime, interpretation: Interpretation
) -> Iterator[tuple[str, datetime]]:
    for each in fleet.members:
        known = fleet.inputs.get(each.name)
        question = Question(subject=each.subject, domain=0, action=Action.JOIN, now=now)
        not_after = known.not_after if known else None
        if end := end_of_rights(each.permissions, question, interpretation, not_after):
            yield each.name, end


def _may_all(members: Iterable[DocumentOwner]) -> bool:
    """Whether an allow_rule has `*`. In a deny_rule, as a participant without rights has it, it
    does not show that a topic exists.
    """
    return any(
        "*" in criteria.topics
        for member in members
        for grant in member.permissions.grants
        for rule in grant.rules
        if rule.allow
        for criteria in (*rule.publish, *rule.subscribe)
    )
