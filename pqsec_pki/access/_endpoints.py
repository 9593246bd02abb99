"""Sets of partitions, or of data tags, that an endpoint may have: those worth asking about."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")

MOST_LARGEST = 500
"""Sets that deny_rules leave of those of allow_rules: they can be exponentially many."""


@dataclass(frozen=True, slots=True)
class Sets(Generic[Item]):
    """The sets, as tuples; `complete` if two policies that agree on them agree on all."""

    tried: tuple[tuple[Item, ...], ...]
    complete: bool


def sets_to_try(
    items: Sequence[Item],
    allowed: Iterable[frozenset[Item]],
    denied: Iterable[frozenset[Item]],
) -> Sets[Item]:
    """The empty set, each item alone, and the largest sets that policies can allow.

    `allowed` are the sets of allow_rules, of which an endpoint must have no other item;
    `denied` those of deny_rules, of which it must have none. So who may do something with
    a set may do it with every part of that set, and policies that allow the same largest
    sets allow the same. A largest one is that of an allow_rule, without those of deny_rules
    that come before it.
    """
    largest, complete = dict.fromkeys(allowed), True
    limit = len(largest) + MOST_LARGEST
    for each in dict.fromkeys(denied):
        left = largest | dict.fromkeys(one - each for one in largest)
        complete = complete and len(left) <= limit
        if complete:
            largest = left
    alone = (frozenset({item}) for item in items)
    found = dict.fromkeys([frozenset[Item](), *alone, *largest])
    place = {item: number for number, item in enumerate(items)}
    return Sets(tuple(tuple(sorted(each, key=place.__getitem__)) for each in found), complete)
