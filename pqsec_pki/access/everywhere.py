"""Answers who may do what on which domains: questions without a domain, or with a topic pattern."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._domains import domain_set as domain_set  # noqa: PLC0414 -- callers use it
from pqsec_pki.access._domains import domains_said as domains_said  # noqa: PLC0414 -- likewise
from pqsec_pki.access._domains import stretches
from pqsec_pki.access._index import Names
from pqsec_pki.access._partitions import Partitions
from pqsec_pki.access._patterns import SPECIAL, posix
from pqsec_pki.access._topics import Extent, Topics
from pqsec_pki.access._witnesses import is_wildcard, sample, witnesses
from pqsec_pki.access.interpretation import Interpretation
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.matrix import DocumentOwner, Matrix, TopicRow, samples, topics_named
from pqsec_pki.documents import DomainRange, DomainSet, Governance, Permissions

_Users: TypeAlias = tuple[tuple[str, ...], tuple[str, ...]]
"""Participants that may publish a topic, and participants that may subscribe to it."""
_Key: TypeAlias = tuple[_Users, frozenset[str]]
"""Users, and names of partitions in which they are those; none for the default partition."""
_Rows: TypeAlias = dict[_Key, tuple[int, ...]]
"""Each with the numbers of the ranges of domains on which they are those."""


_NOBODY: _Key = ((), ()), frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """A row of the matrix, and the domains on which it holds."""

    row: TopicRow
    domains: DomainSet

    @property
    def is_used(self) -> bool:
        """Whether any participant may publish or subscribe."""
        return bool(self.row.publishers or self.row.subscribers)


def domains_apart(
    governance: Governance, every: Iterable[Permissions], *more: DomainSet
) -> tuple[DomainRange, ...]:
    """All domains, in ranges. Within a range, all documents and `more` treat all domains alike.

    This holds for every stack's interpretation.
    """
    sets = {*more, *(rule.domains for rule in governance.domain_rules)}
    sets |= {rule.domains for each in every for grant in each.grants for rule in grant.rules}
    # Some stacks read a range without an end as its first domain only.
    firsts = {DomainSet(parts=(part.first,)) for each in sets for part in _endless(each)}
    return stretches(sets | firsts)


def domains_named(governance: Governance, permissions: Permissions) -> tuple[DomainRange, ...]:
    """The ranges that one of the two documents names; if there is none, the first of all ranges."""
    sets = [rule.domains for rule in governance.domain_rules]
    sets += [rule.domains for grant in permissions.grants for rule in grant.rules]
    every = domains_apart(governance, [permissions])
    return tuple(each for each in every if any(each.first in one for one in sets)) or every[:1]


def domains_ungoverned(governance: Governance, domains: DomainSet) -> list[DomainRange]:
    """The domains of `domains` that the governance does not name, in ranges."""
    return [
        each
        for each in stretches([domains, *(rule.domains for rule in governance.domain_rules)])
        if each.first in domains and governance.rule_for(each.first) is None
    ]


@dataclass(frozen=True, slots=True)
class PlacedRows:
    """Rows of the matrix. If it is not `complete`, a right may be missing that is only in some
    partitions: too many sets of their patterns can cover a partition."""

    rows: tuple[Placed, ...] = ()
    complete: bool = True


def who_may_anywhere(  # noqa: PLR0913 -- what is asked, by name
    governance: Governance,
    members: Sequence[DocumentOwner],
    topics: Iterable[str],
    *,
    domains: DomainSet | None = None,
    partitions: tuple[str, ...] = (),
    now: datetime,
    interpretation: Interpretation = SPEC,
    asked: Mapping[str, str | None],
) -> PlacedRows:
    """For each topic the different rows of the matrix, each with its domains.

    With `partitions`, for an endpoint in all of them. Without, for the default partition; then
    other partitions have rows too, if somebody may there what they may not in the default one.

    Looks at those `domains` that the governance names; None means all that it names. Domains on
    which no participant may use the topic are left out. If no domain is left, the topic has one
    empty row with all domains. If the governance names none of `domains`, there are no rows.
    `asked` has a topic for each pattern.
    """
    every = (each.permissions for each in members)
    apart = domains_apart(governance, every, *(() if domains is None else (domains,)))
    governed = tuple(each for each in apart if governance.rule_for(each.first))
    if domains is not None:
        apart = governed = tuple(each for each in governed if each.first in domains)
    if not governed:
        return PlacedRows()
    asked = samples(members, topics, asked)
    matrix = Matrix(governance, members, asked.values(), now=now, interpretation=interpretation)
    beyond = None if partitions else Partitions(matrix)
    found = _rows_of(matrix, asked, apart, partitions, beyond)
    nobody: _Rows = {_NOBODY: tuple(map(apart.index, governed))}
    sets: dict[tuple[int, ...], DomainSet] = {}
    for where in {where for rows in (*found.values(), nobody) for where in rows.values()}:
        sets[where] = domain_set([apart[number] for number in where])
    described = _described(found, partitions, beyond)
    rows = tuple(
        Placed(
            row=TopicRow(
                topic=topic,
                asked=asked[topic],
                publishers=who[0],
                subscribers=who[1],
                partitions=described[names],
                asked_in=(min(names),) if names else partitions,
            ),
            domains=sets[where],
        )
        for topic, placed in found.items()
        for (who, names), where in (placed or nobody).items()
    )
    return PlacedRows(rows, complete=beyond is None or beyond.complete)


def _described(
    found: Mapping[str, _Rows], partitions: tuple[str, ...], beyond: Partitions | None
) -> dict[frozenset[str], tuple[Topics, ...]]:
    """The partitions of each key; without names, those that were asked about."""
    asked_in = tuple(Topics(name=each, extent=Extent.ONE) for each in partitions)
    described = {frozenset[str](): asked_in}
    if beyond:
        named = {names for rows in found.values() for _, names in rows if names}
        described |= {names: beyond.described(names) for names in named}
    return described


def _rows_of(
    matrix: Matrix,
    asked: Mapping[str, str | None],
    apart: Sequence[DomainRange],
    partitions: tuple[str, ...],
    beyond: Partitions | None,
) -> dict[str, _Rows]:
    """The rows of each topic, which the matrix knows by the sample in `asked`."""
    of_sample: dict[str | None, list[str]] = {}
    for topic, name in asked.items():
        of_sample.setdefault(name, []).append(topic)
    found: dict[str, _Rows] = {topic: {} for topic in asked}
    for number, stretch in enumerate(apart):
        users = matrix.users(stretch.first, partitions)
        here: dict[tuple[str, _Users], set[str]] = {
            (name, users.of(name)): set() for name in users.topics
        }
        for name, partition, who in beyond.only_there(stretch.first, users) if beyond else ():
            here.setdefault((name, who), set()).add(partition)
        for (name, who), names in here.items():
            for topic in of_sample[name]:
                key = who, frozenset(names)
                found[topic][key] = (*found[topic].get(key, ()), number)
    return found


def topics_asked(members: Sequence[DocumentOwner], topics: Iterable[str]) -> dict[str, str | None]:
    """The topics and patterns to answer for `topics`, each with a sample topic for the question.

    A pattern is replaced by everything that it matches: topics that rules name, patterns of
    rules, each with a topic that both cover, and the pattern itself, for topics that none of
    those covers.
    """
    named = topics_named(members)
    literals = frozenset(name for name in named if not is_wildcard(name))
    found: dict[str, str | None] = {}
    for topic in topics:
        if is_wildcard(topic):
            found |= _matching(topic, named, literals)
        else:
            found[topic] = topic
    return found


def is_known(topic: str, named: Sequence[str]) -> bool:
    """Whether one of the `named` topics and patterns covers the topic, or overlaps the pattern."""
    wildcards = [each for each in named if is_wildcard(each)]
    if not is_wildcard(topic):
        return topic in named or any(posix(each, topic) for each in wildcards)
    covered = any(posix(topic, each) for each in named)
    return covered or any(_of_both(topic, each, ()) for each in wildcards)


def _matching(wanted: str, named: Sequence[str], literals: frozenset[str]) -> dict[str, str | None]:
    matched = sorted(Names(literals).covered(wanted))
    found: dict[str, str | None] = {name: name for name in matched}
    for pattern in filter(is_wildcard, named):
        if both := _of_both(wanted, pattern, matched):
            found[pattern] = both
    rest = sample(wanted, literals)
    if rest and not any(posix(each, rest) for each in found):
        found[wanted] = rest
    return found


def _of_both(one: str, other: str, matched: Sequence[str]) -> str | None:
    """A topic that both patterns cover and that is not in `matched`; None if there is none."""
    begins = [SPECIAL.split(each, maxsplit=1)[0] for each in (one, other)]
    if not begins[0].startswith(begins[1]) and not begins[1].startswith(begins[0]):
        return None
    known = [name for name in matched if posix(other, name)]
    found = (name for name in witnesses((one, other, *known)).names if name not in known)
    return next((name for name in found if posix(one, name) and posix(other, name)), None)


def _endless(domains: DomainSet) -> Iterable[DomainRange]:
    return (each for each in domains.parts if isinstance(each, DomainRange) and each.last is None)
