"""Which participants may use each topic, on all domains, as of `policy`; equal participants are one
group."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import SPEC, Action, Placed
from pqsec_pki.documents import DomainRange, DomainSet
from pqsec_pki.policy import Fleet, WhoMay, reason_of, who_may_use
from pqsec_pki.report._names import Grouping, grouped
from pqsec_pki.report.values import (
    Holder,
    HolderExtent,
    Right,
    RightsRow,
    RightsSection,
)


@dataclass(frozen=True, slots=True)
class _Part:
    """A group, by its place, and which of its members."""

    group: int
    extent: HolderExtent
    members: tuple[str, ...]


_Key = tuple[object, ...]


def rights_of(fleet: Fleet, root: Path, now: datetime) -> RightsSection:
    """The rights of the participants of the keystore at `root`, by the standard."""
    answer = who_may_use(fleet, now=now, interpretation=SPEC)
    grouping = grouped(fleet.members)
    found: dict[_Key, list[Placed]] = defaultdict(list)
    for placed in answer.rows:
        if placed.is_used:
            found[_key(placed, grouping)].append(placed)
    explain = _Explaining(fleet, root, now)
    rows = tuple(_row(alike, grouping, explain) for alike in found.values())
    return RightsSection(
        groups=grouping.groups,
        rows=tuple(sorted(rows, key=lambda each: (each.label, each.domains))),
        every=tuple(_every(answer)),
        topics=tuple(dict.fromkeys(each.row.topic for each in answer.rows)),
        refused={**fleet.refused, **answer.unanswered},
        until=answer.until,
    )


def _every(answer: WhoMay) -> Iterator[Right]:
    said: dict[DomainSet, str] = {}
    for each in answer.rows:
        domains = said.get(each.domains) or said.setdefault(each.domains, str(each.domains))
        for action, names in (
            (Action.PUBLISH, each.row.publishers),
            (Action.SUBSCRIBE, each.row.subscribers),
        ):
            for name in names:
                yield Right(name, action.value, each.row.topic, domains, each.row.where)


def _key(placed: Placed, grouping: Grouping) -> _Key:
    """Rows with the same key are shown as one."""
    row = placed.row
    label, unit = grouping.split(row.topic)
    publishers = tuple(_parts(row.publishers, unit, grouping))
    subscribers = tuple(_parts(row.subscribers, unit, grouping))
    where = placed.domains, row.where
    return label, bool(unit), *where, row.is_pattern, publishers, subscribers


def _parts(names: tuple[str, ...], unit: str, grouping: Grouping) -> Iterator[_Part]:
    """The names as groups, in the order of the groups."""
    if len(names) == 1:  # as of most topics
        yield _part(grouping.group_of[names[0]], names, unit, grouping)
        return
    by_group: dict[int, list[str]] = defaultdict(list)
    for name in names:
        by_group[grouping.group_of[name]].append(name)
    for group, there in by_group.items():
        yield _part(group, tuple(there), unit, grouping)


def _part(group: int, names: tuple[str, ...], unit: str, grouping: Grouping) -> _Part:
    own, count = grouping.own.get((group, unit), ()), len(grouping.groups[group].members)
    if len(names) == count:
        return _Part(group, HolderExtent.ALL, ())
    if own and names == own:
        return _Part(group, HolderExtent.OWN, ())
    if own and len(names) == count - len(own) and not set(own) & set(names):
        return _Part(group, HolderExtent.OTHERS, ())
    return _Part(group, HolderExtent.SOME, names)


def _row(alike: list[Placed], grouping: Grouping, explain: "_Explaining") -> RightsRow:
    first = alike[0]
    label, unit = grouping.split(first.row.topic)

    def holders(names: tuple[str, ...], action: Action) -> Iterable[Holder]:
        for part in _parts(names, unit, grouping):
            one = next(each for each in names if grouping.group_of[each] == part.group)
            reason, place = explain.right(one, action, first)
            yield Holder(
                group=grouping.groups[part.group],
                extent=part.extent,
                members=part.members,
                reason=reason,
                place=place,
            )

    return RightsRow(
        label=label if len(alike) > 1 else first.row.topic,
        topics=tuple(each.row.topic for each in alike),
        is_pattern=first.row.is_pattern,
        domains=str(first.domains),
        partitions=first.row.where,
        publishers=tuple(holders(first.row.publishers, Action.PUBLISH)),
        subscribers=tuple(holders(first.row.subscribers, Action.SUBSCRIBE)),
    )


@dataclass(frozen=True, slots=True)
class _Explaining:
    """Asks `policy` for the reason of a right."""

    fleet: Fleet
    root: Path
    now: datetime

    def right(self, name: str, action: Action, placed: Placed) -> tuple[str, str]:
        """The reason, and the file and line below the keystore; "" if no part decided."""
        row = placed.row
        found = reason_of(
            self.fleet.inputs[name],
            action=action,
            topic=row.asked or row.topic,
            domain=_first(placed.domains),
            partitions=row.asked_in,
            now=self.now,
            interpretation=SPEC,
        )
        if found.path is None:
            return found.words, ""
        return found.words, f"{found.path.relative_to(self.root)}:{found.line}"


def _first(domains: DomainSet) -> int:
    part = domains.parts[0]
    return part.first if isinstance(part, DomainRange) else part
