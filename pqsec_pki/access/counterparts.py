"""Rights without a counterpart: what is published and nobody may subscribe to, or the reverse.

Only what is certain is reported: deny_rules are ignored, and two patterns that begin alike count
as overlapping. What ROS 2 gives every node, used or not, is left out.
"""

import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import product

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._domains import stretches
from pqsec_pki.access._patterns import posix
from pqsec_pki.access._witnesses import is_wildcard
from pqsec_pki.access.question import Action
from pqsec_pki.documents import (
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    ros,
)

_EITHER = (Action.PUBLISH, Action.SUBSCRIBE)
_OTHER = {Action.PUBLISH: Action.SUBSCRIBE, Action.SUBSCRIBE: Action.PUBLISH}
_EVERYWHERE = DomainSet(parts=(DomainRange(first=0),))
_ANY_PARTITION = ("*",)
_WILD = re.compile(r"[*?\[\\]")
_WORD = re.compile(r"[^/_]+")
_LETTERS = re.compile(r"[^\W\d_]+")
_LEAST_WORD = 3
"""Letters of a word that can have a typing error: /arm_l and /arm_r are two topics."""
_CACHED = 1 << 14
"""Pairs of domains, or of partitions; a fleet has few."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRight:
    """What one participant may do with a topic or a pattern of topics."""

    owner: str
    action: Action
    topic: str
    domains: DomainSet
    partitions: tuple[str, ...] = ()
    line: int | None = None
    """Of its criteria, in the document."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alone:
    """A right without a counterpart; `meant` is a topic that is spelled alike and has one."""

    right: TopicRight
    meant: str = ""

    def __str__(self) -> str:
        verb = "publish" if self.right.action is Action.PUBLISH else "subscribe to"
        other = "subscribe to" if self.right.action is Action.PUBLISH else "publish"
        text = f"{self.right.owner} may {verb} {self.right.topic}, and nobody may {other} it"
        return f"{text}: did you mean {self.meant}?" if self.meant else text


def rights_of(owner: str, grants: Iterable[Grant]) -> Iterator[TopicRight]:
    """What the grants allow; a default ALLOW is a right to everything."""
    for grant in grants:
        if grant.default is DefaultAction.ALLOW:
            yield from _everything(owner, "*", _EVERYWHERE, _EITHER)
        for rule in grant.rules:
            parts = ((Action.PUBLISH, rule.publish), (Action.SUBSCRIBE, rule.subscribe))
            for action, criteria in parts if rule.allow else ():
                for each in criteria:
                    for topic in each.topics:
                        yield TopicRight(
                            owner=owner,
                            action=action,
                            topic=topic,
                            domains=rule.domains,
                            partitions=each.partitions,
                            line=each.line,
                        )


def open_rights(governance: Governance) -> Iterator[TopicRight]:
    """What the governance allows everyone, whatever their permissions."""
    for rule in governance.domain_rules:
        for each in rule.topic_rules:
            checked = {
                Action.PUBLISH: each.enable_write_access_control,
                Action.SUBSCRIBE: each.enable_read_access_control,
            }
            actions = [action for action, is_checked in checked.items() if not is_checked]
            yield from _everything("everyone", each.topic_expression, rule.domains, actions)


def without_counterpart(
    asked: Iterable[TopicRight], known: Iterable[TopicRight]
) -> Iterator[Alone]:
    """Those of the rights `asked` for which no right in `known` is the other side.

    Only plain topics, and of a service or action only the topic of its request.
    """
    sides = _Sides(known)
    alone = [
        right
        for right in asked
        if not _is_routine(right.topic) and not sides.has_counterpart(right)
    ]
    near = {
        action: _NearTopics(sides.literals(_OTHER[action]), {each.topic for each in of_action})
        for action in _EITHER
        if (of_action := [right for right in alone if right.action is action])
    }
    for right in alone:
        found = (
            topic
            for topic in near[right.action].of(right.topic)
            if sides.is_counterpart(right, topic)
        )
        yield Alone(right=right, meant=min(found, default=""))


def _everything(
    owner: str, topic: str, domains: DomainSet, actions: Iterable[Action]
) -> Iterator[TopicRight]:
    for action in actions:
        yield TopicRight(
            owner=owner, action=action, topic=topic, domains=domains, partitions=_ANY_PARTITION
        )


def _is_routine(topic: str) -> bool:
    """Whether it is no news that a topic has no counterpart, or another topic says it."""
    if is_wildcard(topic) or topic.startswith("rr/"):
        return True
    if "/_action/" in topic:
        return not topic.endswith("/send_goalRequest")
    return ros.is_of_every_node(topic)


class _Sides:
    """Rights by action and topic."""

    def __init__(self, rights: Iterable[TopicRight]) -> None:
        self._rights: dict[Action, dict[str, dict[tuple[object, ...], TopicRight]]] = {
            action: {} for action in _EITHER
        }
        for each in rights:  # those that differ by their owner only are one
            alike = self._rights[each.action].setdefault(each.topic, {})
            alike.setdefault((each.domains, each.partitions), each)
        self._prefixes: dict[Action, dict[str, list[str]]] = {action: {} for action in _EITHER}
        for action, topics in self._rights.items():
            for topic in topics:
                if found := _WILD.search(topic):
                    prefix = topic[: found.start()]
                    self._prefixes[action].setdefault(prefix, []).append(topic)

    def literals(self, action: Action) -> Iterator[str]:
        """The topics, without patterns."""
        return (topic for topic in self._rights[action] if not _WILD.search(topic))

    def has_counterpart(self, right: TopicRight) -> bool:
        """Whether any right is the other side of a plain topic."""
        other = _OTHER[right.action]
        names = {right.topic, *self._patterns(other, right.topic)}
        return any(self.is_counterpart(right, name) for name in names)

    def is_counterpart(self, right: TopicRight, topic: str) -> bool:
        """Whether a right to that topic or pattern is the other side, by domain and partition."""
        found = self._rights[_OTHER[right.action]].get(topic, {})
        return any(_meet(right, each) for each in found.values())

    def _patterns(self, action: Action, topic: str) -> Iterator[str]:
        prefixes = self._prefixes[action]
        for length in range(len(topic) + 1) if prefixes else ():
            for pattern in prefixes.get(topic[:length], ()):
                if posix(pattern, topic):
                    yield pattern


class _NearTopics:
    """Finds those of the topics that differ by one edit of a letter from a wanted one."""

    def __init__(self, topics: Iterable[str], wanted: Iterable[str]) -> None:
        wanted = set(wanted)
        shapes = {(each, size + more) for each, size in map(_shape, wanted) for more in (-1, 0, 1)}
        rests = {rest for topic in wanted for rest in _rests(topic)}
        self._spelled: dict[str, list[str]] = {}
        for topic in topics:  # with few of a large domain both are so
            if _shape(topic) in shapes and not rests.isdisjoint(_rests(topic)):
                for spelling in _spellings(topic):
                    self._spelled.setdefault(spelling, []).append(topic)

    def of(self, wanted: str) -> set[str]:
        """The topics that differ so from this one."""
        return {
            topic
            for spelling in _spellings(wanted)
            for topic in self._spelled.get(spelling, ())
            if is_one_edit(wanted, topic)
        }


def is_one_edit(one: str, other: str) -> bool:
    """Whether one letter is missing, added, exchanged, or two are swapped, within a word.

    Not if it is a digit: /robot1 and /robot2 are two robots.
    """
    words: zip[tuple[str, str]] = zip(_WORD.findall(one), _WORD.findall(other), strict=False)
    apart = [pair for pair in words if pair[0] != pair[1]]
    if len(apart) != 1 or _WORD.sub("", one) != _WORD.sub("", other):
        return False
    short, long = sorted(apart[0], key=len)
    if len(long) < _LEAST_WORD or len(long) - len(short) > 1:
        return False
    start = next(
        (n for n, (a, b) in enumerate(zip(short, long, strict=False)) if a != b), len(short)
    )
    if len(short) < len(long):
        return short[start:] == long[start + 1 :] and long[start].isalpha()
    ends = short[start + 1 :], long[start + 1 :]
    if ends[0] == ends[1]:
        return short[start].isalpha() and long[start].isalpha()
    swapped = long[start + 1 : start + 2] + long[start : start + 1] + long[start + 2 :]
    return short[start:] == swapped and short[start : start + 2].isalpha()


def _shape(topic: str) -> tuple[str, int]:
    """What is left without letters, which an edit does not change, and the length."""
    return _LETTERS.sub("", topic), len(topic)


def _rests(topic: str) -> Iterator[str]:
    """The topic without the letters of one word: the same for topics that differ by one edit."""
    for word in _WORD.finditer(topic):
        yield f"{topic[: word.start()]}{_LETTERS.sub('', word[0])}{topic[word.end() :]}"


def _spellings(topic: str) -> set[str]:
    """The topic, and what is left of it without one letter of a word that may have an error."""
    places = (
        place
        for word in _WORD.finditer(topic)
        if word.end() - word.start() >= _LEAST_WORD
        for place in range(word.start(), word.end())
        if topic[place].isalpha()
    )
    return {topic, *(topic[:n] + topic[n + 1 :] for n in places)}


def _meet(one: TopicRight, other: TopicRight) -> bool:
    return _domains_meet(one.domains, other.domains) and _partitions_meet(
        one.partitions or ("",), other.partitions or ("",)
    )


@lru_cache(_CACHED)
def _domains_meet(one: DomainSet, other: DomainSet) -> bool:
    return any(each.first in one and each.first in other for each in stretches([one, other]))


@lru_cache(_CACHED)
def _partitions_meet(some: tuple[str, ...], others: tuple[str, ...]) -> bool:
    return any(
        posix(one, other) or posix(other, one) or (is_wildcard(one) and is_wildcard(other))
        for one, other in product(some, others)
    )
