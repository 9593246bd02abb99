"""What participants can send to each other, from the rows of who may use each topic."""

from collections.abc import Iterable
from operator import itemgetter

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Placed, Topics
from pqsec_pki.documents import DomainSet, ros


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """What one participant can send to others: the same topics to all of them."""

    sender: str
    receivers: tuple[str, ...]
    domains: DomainSet
    partitions: tuple[Topics, ...]
    where: str
    """The partitions in words; empty for the default partition."""
    topics: tuple[str, ...]
    """DDS topics, and patterns."""

    def to_json(self) -> dict[str, object]:
        """With the topics also in the words of ROS 2."""
        return {
            "from": self.sender,
            "to": list(self.receivers),
            "domains": str(self.domains),
            "partitions": [each.to_json() for each in self.partitions],
            "topics": list(self.topics),
            "ros": list(map(ros.said, self.topics)),
        }


def flows(rows: Iterable[Placed]) -> list[Flow]:
    """What each participant can send, and the receivers.

    Without the discovery topic of ROS 2, which all nodes share, and without what participants
    send to themselves.
    """
    found: dict[tuple[str, str, str, tuple[str, ...]], tuple[Placed, list[str]]] = {}
    for each in rows:
        row = each.row
        if row.topic == ros.DISCOVERY or not row.subscribers:
            continue
        both = {*row.publishers} & {*row.subscribers}
        for sender in row.publishers:
            others = row.subscribers
            if sender in both:
                others = tuple(name for name in others if name != sender)
            key = sender, str(each.domains), row.where, others
            if others:
                found.setdefault(key, (each, []))[1].append(row.topic)
    return [
        Flow(
            sender=sender,
            receivers=others,
            domains=first.domains,
            partitions=first.row.partitions,
            where=where,
            topics=tuple(topics),
        )
        for (sender, _, where, others), (first, topics) in sorted(found.items(), key=itemgetter(0))
    ]
