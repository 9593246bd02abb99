"""Rights of a fleet that are only in partitions: beside those in the default partition.

An endpoint without a partition is in the default partition. Who may use a topic there says nothing
of other partitions: an allow_rule for partition A is for A alone. A policy that allows an endpoint
in several partitions allows it in each of them, so questions about one partition find every right.
"""

from collections.abc import Iterator, Mapping
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._index import Names
from pqsec_pki.access._topics import SampleNames, Topics
from pqsec_pki.access.matrix import Matrix, MatrixMember, TopicUsers, criteria_of
from pqsec_pki.access.question import MAX_NAME
from pqsec_pki.documents import DefaultAction

_DEFAULT = ""
_Uses: TypeAlias = tuple[tuple[str, ...], tuple[str, ...]]
"""Publishers and subscribers."""


@dataclass(frozen=True, slots=True)
class _InPartitions:
    """Who may use which topics in the partitions of one member's patterns, and in all others."""

    named: Mapping[str, TopicUsers]
    """By a name of a partition: the participants with a pattern that covers it."""
    others: TopicUsers
    """The participants that may in partitions that none of their patterns covers."""
    covered: Mapping[str, frozenset[str]]
    """The names that the patterns of each participant cover."""

    def users(self, partition: str, topic: str) -> _Uses:
        publishers, subscribers = self.others.of(topic)
        own = self.named[partition].of(topic)
        return own[0] + self._free(publishers, partition), own[1] + self._free(
            subscribers, partition
        )

    def _free(self, names: tuple[str, ...], partition: str) -> tuple[str, ...]:
        """Those of them whose patterns do not cover the partition."""
        return tuple(name for name in names if partition not in self.covered[name])


class Partitions:
    """The partitions that the members of a matrix distinguish, by one name for each kind."""

    def __init__(self, matrix: Matrix) -> None:
        self._matrix = matrix
        patterns = [pattern for each in matrix.members for pattern in _patterns(each)]
        self._samples = SampleNames(patterns, "partition", also=(_DEFAULT,))
        # Without patterns only a default can allow more there: Cyclone DDS takes a deny_rule
        # without partitions for one of the default partition.
        is_asked = patterns or any(
            each.grant.default is DefaultAction.ALLOW for each in matrix.members
        )
        known = (each for each in self._samples.names if each and len(each) <= MAX_NAME)
        self._names = Names(known if is_asked else ())
        self._place = {member.name: place for place, member in enumerate(matrix.members)}
        self._covered: dict[tuple[str, ...], frozenset[str]] = {}

    @property
    def complete(self) -> bool:
        """Whether there is a name for each set of patterns that can cover one."""
        return self._samples.complete

    def described(self, names: frozenset[str]) -> tuple[Topics, ...]:
        """These partitions, by the patterns of the rules."""
        return self._samples.described(names)

    def only_there(self, domain: int, default: TopicUsers) -> Iterator[tuple[str, str, _Uses]]:
        """Topic, partition and who may use it there: where somebody may who has not that right in
        the `default` partition."""
        found = self._found(domain)
        everywhere = list(_beyond(found.others, default))
        for name in self._names.sorted:
            for topic in dict.fromkeys([*_beyond(found.named[name], default), *everywhere]):
                users = found.users(name, topic)
                if _is_beyond(users, default.of(topic)):
                    publishers, subscribers = (self._ordered(each) for each in users)
                    yield topic, name, (publishers, subscribers)

    def _found(self, domain: int) -> _InPartitions:
        named = {name: TopicUsers({}, {}) for name in self._names.sorted}
        others, covered = TopicUsers({}, {}), dict[str, frozenset[str]]()
        for member in self._matrix.members:
            patterns = _patterns(member)
            covered[member.name] = mine = self._covered_by(patterns)
            for alike in self._alike(patterns, mine):
                uses = list(self._matrix.uses(member, domain, (alike[0],)))
                for name in alike:
                    named[name].add(member.name, uses)
            free = next((name for name in self._names.sorted if name not in mine), None)
            if free is not None:
                others.add(member.name, self._matrix.uses(member, domain, (free,)))
        return _InPartitions(named, others, covered)

    def _covered_by(self, patterns: tuple[str, ...]) -> frozenset[str]:
        if patterns not in self._covered:
            found = self._names.covered_by(patterns, self._matrix.interpretation.covers)
            self._covered[patterns] = frozenset(found)
        return self._covered[patterns]

    def _alike(self, patterns: tuple[str, ...], names: frozenset[str]) -> Iterator[list[str]]:
        """The names, those together that the same of the patterns cover."""
        covers, found = self._matrix.interpretation.covers, dict[object, list[str]]()
        for name in sorted(names):
            found.setdefault(tuple(covers(each, name) for each in patterns), []).append(name)
        yield from found.values()

    def _ordered(self, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(sorted(names, key=self._place.__getitem__))


def _patterns(member: MatrixMember) -> tuple[str, ...]:
    return tuple(
        dict.fromkeys(name for each in criteria_of(member.grant) for name in each.partitions)
    )


def _beyond(users: TopicUsers, default: TopicUsers) -> Iterator[str]:
    """The topics for which somebody may what nobody, or another, may in the default partition."""
    return (topic for topic in users.topics if _is_beyond(users.of(topic), default.of(topic)))


def _is_beyond(users: _Uses, default: _Uses) -> bool:
    return any(not {*here} <= {*there} for here, there in zip(users, default, strict=True))
