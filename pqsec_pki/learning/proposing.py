"""Permissions that allow what was seen, and what ROS 2 nodes need to start; nothing else."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Action
from pqsec_pki.documents import DomainSet, Grant, permissions_from_yaml, ros
from pqsec_pki.documents.parts_yaml import domains_as_yaml, dump, node_as_yaml
from pqsec_pki.errors import shown
from pqsec_pki.learning.seen import Endpoint, NotProposed, SeenParticipant

MAX_TOPIC = 255
"""Characters of a topic (`string<256>` in RTPS, with its end)."""
_PATTERN = set("*?[]\\")
"""In permissions these match other names (fnmatch), so a name that has one is not written."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """The permissions of one participant."""

    name: str
    grant: Grant
    text: str
    """The grant in YAML, an item of `grants`."""


@dataclass(frozen=True, slots=True)
class Proposed:
    """All proposals, and the names that cannot be in them."""

    proposals: tuple[Proposal, ...]
    left_out: tuple[NotProposed, ...]


def propose(participants: Sequence[SeenParticipant], *, validity: str, now: datetime) -> Proposed:
    """Permissions for each participant, valid for a duration such as `90d`.

    A topic or partition that is a pattern is left out: as permissions it would allow more.
    """
    proposals, left_out = [], []
    for each in participants:
        unfit = {point: reason for point in each.endpoints if (reason := _unfit(point))}
        left_out += [
            NotProposed(f"{each.name}: {point.action} '{shown(point.topic)}'", reason)
            for point, reason in sorted(unfit.items())
        ]
        fit = each.endpoints - unfit.keys()
        if fit:
            written = {"name": each.name, "validity": validity, **_rules(each.nodes, fit)}
            data = dump({"grants": [written]})
            [grant] = permissions_from_yaml(data, now=now).grants
            proposals.append(Proposal(each.name, grant, data.decode().split("\n", 1)[1]))
    return Proposed(tuple(proposals), tuple(left_out))


def document_of(
    proposals: Iterable[Proposal], head: Iterable[str], notes: Mapping[str, Iterable[str]]
) -> str:
    """The YAML document; `head` and the `notes` of each name are comments, a line each."""
    parts = [*(f"# {each}\n" for each in head), "grants:\n"]
    for each in proposals:
        parts += (f"  # {note}\n" for note in notes.get(each.name, ()))
        parts.append(each.text)
    return "".join(parts)


def _unfit(point: Endpoint) -> str:
    for what, name in (("topic", point.topic), *(("partition", p) for p in point.partitions)):
        if _PATTERN & set(name):
            return f"the {what} '{shown(name)}' is a pattern: write the rule yourself"
        if len(name) > MAX_TOPIC or not name.isprintable():
            return f"the {what} has a name that permissions cannot have"
    return ""


def _rules(nodes: Sequence[str], points: Iterable[Endpoint]) -> dict[str, object]:
    """The keys of a grant: in the short form, if all domains have the same rule."""
    by_domain: dict[int, list[Endpoint]] = {}
    for point in sorted(points):
        by_domain.setdefault(point.domain, []).append(point)
    alike: dict[bytes, tuple[list[int], dict[str, object]]] = {}
    for domain, own in by_domain.items():
        rule = _rule(nodes, own)
        alike.setdefault(dump(rule), ([], rule))[0].append(domain)
    rules = [
        {"domains": domains_as_yaml(DomainSet.of(*domains)), **rule}
        for domains, rule in alike.values()
    ]
    return rules[0] if len(rules) == 1 else {"rules": [{"allow": rule} for rule in rules]}


def _rule(nodes: Sequence[str], points: Sequence[Endpoint]) -> dict[str, object]:
    plain = [each for each in points if not each.partitions]
    left = ros.Endpoints(_topics(plain, Action.PUBLISH), _topics(plain, Action.SUBSCRIBE))
    items = []
    used: tuple[set[str], set[str]] = set(), set()
    # Which of several nodes uses a topic is known only for names below a node's own.
    below = {nodes[0]: left} if len(nodes) == 1 else _below(nodes, left)
    for node in nodes:
        own = _without(below[node], used)
        item, rest = node_as_yaml(node, own)
        items.append(item)
        for gone, all_, kept in zip(used, own, rest, strict=True):
            gone.update({*all_}.difference(kept))
    left = _without(left, used)
    rule: dict[str, object] = {"nodes": items} if items else {}
    for action, topics in ((Action.PUBLISH, left.publish), (Action.SUBSCRIBE, left.subscribe)):
        by_partitions: dict[tuple[str, ...], list[str]] = {}
        for each in points:
            if each.action is action and each.partitions:
                by_partitions.setdefault(each.partitions, []).append(each.topic)
        written: list[object] = [
            *topics,
            *(
                {"topics": names, "partitions": list(partitions)}
                for partitions, names in by_partitions.items()
            ),
        ]
        if written:
            rule[action.value] = written
    return rule


def _topics(points: Iterable[Endpoint], action: Action) -> tuple[str, ...]:
    return tuple(each.topic for each in points if each.action is action)


def _below(nodes: Sequence[str], topics: ros.Endpoints) -> dict[str, ros.Endpoints]:
    """Node -> the topics below its name; this looks at each topic once."""
    found: dict[str, tuple[list[str], list[str]]] = {node: ([], []) for node in nodes}
    for way, names in enumerate(topics):
        for name in names:
            parts = name[2:].split("/")
            for end in range(1, len(parts)):
                if own := found.get("/".join(parts[:end])):
                    own[way].append(name)
    return {node: ros.Endpoints(tuple(pub), tuple(sub)) for node, (pub, sub) in found.items()}


def _without(topics: ros.Endpoints, used: tuple[set[str], set[str]]) -> ros.Endpoints:
    return ros.Endpoints(
        *(
            tuple(each for each in names if each not in gone)
            for names, gone in zip(topics, used, strict=True)
        )
    )
