"""Rights at a glance: the matrix, and the picture of participants and topics. Both leave out what
ROS 2 gives to every node alone; the table of the page has all.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import ros
from pqsec_pki.report.values import Holder, ParticipantGroup, RightsRow, RightsSection

MOST_COLUMNS = 24
"""Groups in the matrix; more cannot be read. On paper, 10 fit."""
MOST_FLOWS = 60
"""Boxes of topics in the picture; more cannot be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureTopic:
    """A topic of the picture, or those of one side of an action as one."""

    label: str
    rows: tuple[RightsRow, ...]

    @property
    def is_pattern(self) -> bool:
        """Whether it is, or has, a pattern."""
        return any(each.is_pattern for each in self.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureFlow:
    """Topics that the same participants may publish, and the same may subscribe to."""

    where: str
    """Domains and partitions."""
    topics: tuple[PictureTopic, ...]
    publishers: tuple[Holder, ...]
    subscribers: tuple[Holder, ...]

    @property
    def folded(self) -> tuple[str, ...]:
        """The topics that a group replaces, so that Find on the page finds them too."""
        several = (each.rows for each in self.topics if len(each.rows) > 1)
        return tuple(row.label for rows in several for row in rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """Groups on both sides, and the flows between them."""

    senders: tuple[ParticipantGroup, ...]
    receivers: tuple[ParticipantGroup, ...]
    flows: tuple[PictureFlow, ...]
    more: int
    """How many flows are left out."""


Cells = list[list[tuple[str, Holder]]]
"""For each group, what it may do, and by which rule."""


def is_routine(row: RightsRow) -> bool:
    """Whether ROS 2 gives the topics to every node, and no participant can command another by
    them."""
    is_discovery = ros.DISCOVERY in row.topics
    alone = not row.publishers or not row.subscribers
    return is_discovery or (alone and all(map(ros.is_of_every_node, row.topics)))


def matrix_of(rights: RightsSection) -> list[tuple[RightsRow, Cells]]:
    """Each row that is not routine with a cell for each group; none with too many groups."""
    if len(rights.groups) > MOST_COLUMNS:
        return []
    return [
        (row, [list(_cell(group, row)) for group in rights.groups])
        for row in rights.rows
        if not is_routine(row)
    ]


def _cell(group: ParticipantGroup, row: RightsRow) -> Iterable[tuple[str, Holder]]:
    for action, holders in (("publish", row.publishers), ("subscribe", row.subscribers)):
        yield from ((action, each) for each in holders if each.group is group)


def picture_of(rights: RightsSection) -> Picture:
    """The flows; those between most groups first."""
    alike: dict[object, list[RightsRow]] = defaultdict(list)
    for row in rights.rows:
        if not is_routine(row):
            alike[row.where, _parts(row.publishers), _parts(row.subscribers)].append(row)
    flows = [
        PictureFlow(
            where=rows[0].where,
            topics=tuple(_folded(rows)),
            publishers=rows[0].publishers,
            subscribers=rows[0].subscribers,
        )
        for rows in alike.values()
    ]
    flows.sort(key=lambda each: not (each.publishers and each.subscribers))
    shown = flows[:MOST_FLOWS]
    return Picture(
        senders=_used(rights.groups, [holder for each in shown for holder in each.publishers]),
        receivers=_used(rights.groups, [holder for each in shown for holder in each.subscribers]),
        flows=tuple(shown),
        more=len(flows) - len(shown),
    )


def _folded(rows: Sequence[RightsRow]) -> Iterable[PictureTopic]:
    """The topics, in order; those of an action where the first of them is."""
    sides = ros.action_sides(each.label for each in rows)
    label_of = {topic: label for label, topics in sides.items() for topic in topics}
    together: dict[str, list[RightsRow]] = defaultdict(list)
    for row in rows:
        together[label_of.get(row.label, row.label)].append(row)
    return (PictureTopic(label=label, rows=tuple(alike)) for label, alike in together.items())


def _parts(holders: Sequence[Holder]) -> tuple[object, ...]:
    return tuple((id(each.group), each.extent, each.members) for each in holders)


def _used(
    groups: Sequence[ParticipantGroup], holders: Iterable[Holder]
) -> tuple[ParticipantGroup, ...]:
    used = {id(each.group) for each in holders}
    return tuple(each for each in groups if id(each) in used)
