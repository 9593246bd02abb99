"""The sets of partitions, or of data tags, of an endpoint that suffice to compare policies."""

from collections.abc import Iterable, Sequence
from typing import Generic, TypeVar

from pqsec_pki._dataclass import dataclass

Item = TypeVar("Item")

MOST_LARGEST = 500
"""Most sets that deny_rules leave of those of allow_rules: the number can be exponential."""


@dataclass(frozen=True, slots=True)
class Sets(Generic[Item]):
    """The sets, as tuples; `complete` if two policies that agree on them agree on all sets."""

    tried: tuple[tuple[Item, ...], ...]
    complete: bool


def sets_to_try(
    items: Sequence[Item],
    allowed: Iterable[frozenset[Item]],
    denied: Iterable[frozenset[Item]],
) -> Sets[Item]:
    """The empty set, each item alone, and the largest sets that policies can allow.

    `allowed` are the sets of allow_rules: an endpoint may have only items of one of them.
    `denied` are the sets of deny_rules: an endpoint may have none of their items. So a policy
    that allows a set allows every part of it, and policies that allow the same largest sets are
    equal. A largest set is the set of an allow_rule without the sets of earlier deny_rules.
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
