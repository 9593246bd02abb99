"""Ranges of domains that are equal for all given sets of domains."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

from pqsec_pki.documents import MAX_DOMAIN_ID, DomainRange, DomainSet


def stretches(sets: Iterable[DomainSet]) -> tuple[DomainRange, ...]:
    """All domains, in ranges that are divided where one of the sets begins or ends."""
    cuts = {0, MAX_DOMAIN_ID + 1}
    for part in (part for each in sets for part in each.parts):
        first, last = (part.first, part.last) if isinstance(part, DomainRange) else (part, part)
        cuts |= {first} if last is None else {first, last + 1}
    return tuple(DomainRange(first=one, last=next_ - 1) for one, next_ in pairwise(sorted(cuts)))


def domains_said(found: Sequence[DomainRange]) -> str:
    """The ranges as text: `domain 0`, `domains 0-3, 5`, `every domain`."""
    joined = _joined(found)
    if [(each.first, each.last) for each in joined] == [(0, MAX_DOMAIN_ID)]:
        return "every domain"
    words = ", ".join(map(_said, joined))
    one = len(joined) == 1 and joined[0].first == joined[0].last
    return f"domain{'' if one else 's'} {words}"


def domain_set(found: Sequence[DomainRange]) -> DomainSet:
    """Some of the ranges as one set, whose text is short: 0,2-5."""
    return DomainSet(
        parts=tuple(
            each.first
            if each.first == each.last
            else DomainRange(
                first=each.first, last=None if each.last == MAX_DOMAIN_ID else each.last
            )
            for each in _joined(found)
        )
    )


def _joined(found: Sequence[DomainRange]) -> list[DomainRange]:
    """The ranges in order; those that follow one another are joined."""
    joined: list[DomainRange] = []
    for each in sorted(found, key=lambda each: each.first):
        before = joined[-1] if joined else None
        if before and before.last is not None and each.first == before.last + 1:
            joined[-1] = DomainRange(first=before.first, last=each.last)
        else:
            joined.append(each)
    return joined


def _said(each: DomainRange) -> str:
    if each.last == MAX_DOMAIN_ID:
        return f"{each.first} and up"
    return str(each.first) if each.first == each.last else str(each)
