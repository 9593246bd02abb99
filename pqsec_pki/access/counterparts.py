"""Rights without a counterpart: to publish without a permitted subscriber, or the reverse.

Only what is certain is reported: deny_rules are ignored, and two patterns that begin alike count
as overlapping. What ROS 2 gives every node, used or not, is left out.
"""

import re
from collections.abc import Iterable, Iterator
from itertools import product
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._domains import stretches
from pqsec_pki.access._patterns import SPECIAL, posix
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
_WORD = re.compile(r"[^/_]+")
_LETTERS = re.compile(r"[^\W\d_]+")
_LEAST_WORD = 3
"""Letters of a word that can have a typing error: /arm_l and /arm_r are two topics."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CriteriaRight:
    """What one participant may do with the topics, or patterns, of criteria."""

    owner: str
    action: Action
    topics: tuple[str, ...]
    domains: DomainSet
    partitions: tuple[str, ...] = ()
    line: int | None = None
    """The line of the criteria in the document."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRight:
    """What one participant may do with one topic."""

    owner: str
    action: Action
    topic: str
    line: int | None = None
    """The line of its criteria in the document."""


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


def rights_of(owner: str, grants: Iterable[Grant]) -> Iterator[CriteriaRight]:
    """What the grants allow; a default ALLOW is a right to everything."""
    for grant in grants:
        if grant.default is DefaultAction.ALLOW:
            yield from _everything(owner, "*", _EVERYWHERE, _EITHER)
        for rule in grant.rules:
            parts = ((Action.PUBLISH, rule.publish), (Action.SUBSCRIBE, rule.subscribe))
            for action, criteria in parts if rule.allow else ():
                for each in criteria:
                    yield CriteriaRight(
                        owner=owner,
                        action=action,
                        topics=each.topics,
                        domains=rule.domains,
                        partitions=each.partitions,
                        line=each.line,
                    )


def open_rights(governance: Governance) -> Iterator[CriteriaRight]:
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
    asked: Iterable[CriteriaRight], known: Iterable[CriteriaRight]
) -> Iterator[Alone]:
    """The rights in `asked`, by topic, for which no right in `known` is the other side.

    Only plain topics, and of a service or action only the topic of its request.
    """
    sides = _Sides(known)
    alone = [(right, topic) for right in asked for topic in sides.alone(right)]
    near = {
        action: _NearTopics(sides.literals(_OTHER[action]), wanted)
        for action in _EITHER
        if (wanted := {topic for right, topic in alone if right.action is action})
    }
    for right, topic in alone:
        found = near[right.action].of(topic)
        single = TopicRight(owner=right.owner, action=right.action, topic=topic, line=right.line)
        yield Alone(right=single, meant=min(sides.used(right, found), default=""))


def _everything(
    owner: str, topic: str, domains: DomainSet, actions: Iterable[Action]
) -> Iterator[CriteriaRight]:
    for action in actions:
        yield CriteriaRight(
            owner=owner,
            action=action,
            topics=(topic,),
            domains=domains,
            partitions=_ANY_PARTITION,
        )


def _is_routine(topic: str) -> bool:
    """Whether a missing counterpart is usual for this topic, or another topic of its service shows
    it."""
    if topic.startswith("rr/") or is_wildcard(topic):
        return True
    if "/_action/" in topic:
        return not topic.endswith("/send_goalRequest")
    return ros.is_of_every_node(topic)


_Place: TypeAlias = tuple[DomainSet, tuple[str, ...]]
"""Domains and partitions."""


class _Sides:
    """Where rights hold, by action and topic."""

    def __init__(self, rights: Iterable[CriteriaRight]) -> None:
        self._numbers: dict[_Place, int] = {}
        """Place -> its number; a fleet has few places."""
        self._places: dict[int, _Place] = {}
        self._meeting: dict[tuple[int, int], bool] = {}
        self._of: dict[Action, dict[str, set[int]]] = {action: {} for action in _EITHER}
        for right in rights:
            number, topics = self._number(right), self._of[right.action]
            for topic in right.topics:
                topics.setdefault(topic, set()).add(number)
        self._prefixes: dict[Action, dict[str, list[str]]] = {action: {} for action in _EITHER}
        for action, topics in self._of.items():
            for topic in topics:
                if found := SPECIAL.search(topic):
                    prefix = topic[: found.start()]
                    self._prefixes[action].setdefault(prefix, []).append(topic)

    def literals(self, action: Action) -> Iterator[str]:
        """The topics, without patterns."""
        return (topic for topic in self._of[action] if not SPECIAL.search(topic))

    def alone(self, right: CriteriaRight) -> Iterator[str]:
        """Topics of `right` for which no right is the other side, except those of `_is_routine`."""
        own, other = self._number(right), _OTHER[right.action]
        for topic in right.topics:
            if not _is_routine(topic) and not self._is_used(own, other, topic):
                patterns = self._patterns(other, topic)
                if not any(self._is_used(own, other, each) for each in patterns):
                    yield topic

    def used(self, right: CriteriaRight, topics: Iterable[str]) -> Iterator[str]:
        """The topics for which a right is the other side, by domain and partition."""
        own, other = self._number(right), _OTHER[right.action]
        return (topic for topic in topics if self._is_used(own, other, topic))

    def _is_used(self, own: int, action: Action, topic: str) -> bool:
        return any(self._meet(own, each) for each in self._of[action].get(topic, ()))

    def _number(self, right: CriteriaRight) -> int:
        place = right.domains, right.partitions or ("",)
        number = self._numbers.setdefault(place, len(self._numbers))
        self._places[number] = place
        return number

    def _meet(self, one: int, other: int) -> bool:
        known = self._meeting.get((one, other))
        if known is None:
            (domains, partitions), (others, theirs) = self._places[one], self._places[other]
            known = _domains_meet(domains, others) and _partitions_meet(partitions, theirs)
            self._meeting[one, other] = known
        return known

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
            for spelling in (_spellings(wanted) if self._spelled else ())
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
    """The topic without letters, which an edit does not change, and its length."""
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


def _domains_meet(one: DomainSet, other: DomainSet) -> bool:
    return any(each.first in one and each.first in other for each in stretches([one, other]))


def _partitions_meet(some: tuple[str, ...], others: tuple[str, ...]) -> bool:
    return any(
        posix(one, other) or posix(other, one) or (is_wildcard(one) and is_wildcard(other))
        for one, other in product(some, others)
    )
