"""Groups of participants that differ only in their names, and topics that differ likewise.

It serves reading only: rights are what `policy` answers, and a group that is not found makes a
report longer, not wrong.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import DocumentOwner
from pqsec_pki.documents import Criteria
from pqsec_pki.report.values import ParticipantGroup

PLACEHOLDER = "{name}"
"""The placeholder in a label for the part in which names differ."""
_ONE = {1}


@dataclass(frozen=True, slots=True)
class Grouping:
    """The groups, the group of each participant, and the parts in which their names differ."""

    groups: tuple[ParticipantGroup, ...]
    group_of: dict[str, int]
    """By their place in `groups`."""
    own: dict[tuple[int, str], tuple[str, ...]]
    """For a group of several and a unit, the members with it: `tb3` of /tb3/camera, if there is
    /tb4/camera."""
    units: frozenset[str]
    lengths: frozenset[int]
    """How many parts a unit may have."""

    def split(self, topic: str) -> tuple[str, str]:
        """The topic with `{name}` in place of the one unit in it, and that unit.

        The topic itself and "" if no unit is in it, or several are.
        """
        parts = topic.split("/")
        plain = self.lengths == _ONE  # as nearly always
        found = self.units.intersection(parts if plain else _windows(parts, self.lengths))
        if len(found) != 1:
            return topic, ""
        [unit] = found
        return _replaced(parts, unit.split("/")), unit


def grouped(members: Sequence[DocumentOwner]) -> Grouping:
    """The groups of the members, in the order of their first members."""
    alike: dict[object, list[str]] = defaultdict(list)
    for member in members:
        alike[_shape(member)].append(member.name)
    groups = list[ParticipantGroup]()
    group_of, own = dict[str, int](), defaultdict[tuple[int, str], list[str]](list)
    for names in (part for each in alike.values() for part in _parted(each)):
        first, last = _varying(names)
        parts = names[0].split("/")
        label = [*parts[:first], PLACEHOLDER, *parts[last + 1 :]] if len(names) > 1 else parts
        group = ParticipantGroup(label="/".join(label), members=tuple(names))
        group_of |= dict.fromkeys(names, len(groups))
        for name in names if len(names) > 1 else ():
            own[len(groups), "/".join(name.split("/")[first : last + 1])].append(name)
        groups.append(group)
    units = frozenset(unit for _, unit in own)
    lengths = frozenset(each.count("/") + 1 for each in units)
    alone = {key: tuple(names) for key, names in own.items()}
    return Grouping(tuple(groups), group_of, alone, units, lengths)


def _shape(member: DocumentOwner) -> object:
    """What members of a group have in common: the rules, without the member's name."""
    parts = set(member.name.split("/")) - {""}

    def plain(topics: Iterable[str]) -> tuple[str, ...]:
        return tuple(
            "/".join(PLACEHOLDER if part in parts else part for part in topic.split("/"))
            for topic in topics
        )

    def criteria(each: Criteria) -> object:
        return plain(each.topics), each.partitions, each.data_tags

    grants = member.permissions.grants_for(member.subject)
    return (
        member.name.count("/"),
        len(member.permissions.grants),
        tuple(
            (
                grant.default,
                tuple(
                    (
                        rule.allow,
                        rule.line,
                        rule.domains,
                        tuple(map(criteria, rule.publish)),
                        tuple(map(criteria, rule.subscribe)),
                        tuple(map(criteria, rule.relay)),
                    )
                    for rule in grant.rules
                ),
            )
            for grant in grants
        ),
    )


def _parted(names: list[str]) -> Iterator[list[str]]:
    """By their last parts, if they differ in several: nodes of the same name on many robots."""
    first, last = _varying(names)
    by_last: dict[str, list[str]] = defaultdict(list)
    for name in names:
        by_last[name.rpartition("/")[2]].append(name)
    if first == last or len(by_last) == len(names) or min(map(len, by_last.values())) == 1:
        yield names
    else:
        yield from by_last.values()


def _varying(names: list[str]) -> tuple[int, int]:
    """The first and the last part in which the names differ; the last part if they do not."""
    columns = list(zip(*(name.split("/") for name in names), strict=True))
    varying = [place for place, parts in enumerate(columns) if len(set(parts)) > 1]
    end = len(columns) - 1
    return (varying[0], varying[-1]) if varying else (end, end)


def _windows(parts: list[str], lengths: Iterable[int]) -> Iterator[str]:
    for length in lengths:
        for start in range(len(parts) - length + 1):
            yield "/".join(parts[start : start + length])


def _replaced(parts: list[str], unit: list[str]) -> str:
    if len(unit) == 1:
        return "/".join([PLACEHOLDER if part == unit[0] else part for part in parts])
    made, place = [], 0
    while place < len(parts):
        if parts[place : place + len(unit)] == unit:
            made.append(PLACEHOLDER)
            place += len(unit)
        else:
            made.append(parts[place])
            place += 1
    return "/".join(made)
