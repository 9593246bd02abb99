"""Finds patterns that cover a later one, which then has no effect: the first match decides.

Only certain cases are reported, in time linear in the number of patterns: of patterns that
are neither plain names nor a prefix with `*`, only the first ODD_PATTERNS are kept.
"""

import re
from bisect import bisect_left, insort
from collections.abc import Iterator
from dataclasses import field
from typing import Generic, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import SPEC
from pqsec_pki.documents import DomainRange, DomainSet

ODD_PATTERNS = 32
MAX_NAME = 256
"""Longest topic name in DDS (255 characters), plus one."""
_WILD = re.compile(r"[*?\[\]\\]")

Mark = TypeVar("Mark")


def covers_all(pattern: str) -> bool:
    """Whether it matches every topic. `?*` does, because no name is empty."""
    return "*" in pattern and pattern.replace("?", "", 1).strip("*") == ""


@dataclass(slots=True)
class Patterns(Generic[Mark]):
    """Earlier patterns, each with a mark that says where it is."""

    names: dict[str, Mark] = field(default_factory=dict)
    prefixes: dict[str, Mark] = field(default_factory=dict)
    odd: list[tuple[str, Mark]] = field(default_factory=list)

    def add(self, pattern: str, mark: Mark) -> None:
        """Add a pattern; of two equal ones, the first is kept."""
        start = pattern.rstrip("*")
        if pattern not in self.names:
            self.names[pattern] = mark
        if start != pattern and not _WILD.search(start):
            self.prefixes.setdefault(start, mark)
        elif _WILD.search(pattern) and not re.search(r"[\[\]\\]", pattern):
            self.odd += [(pattern, mark)] if len(self.odd) < ODD_PATTERNS else []

    def covering(self, pattern: str) -> Iterator[Mark]:
        """The marks of earlier patterns that match everything that `pattern` matches."""
        if pattern in self.names:
            yield self.names[pattern]
        wild = _WILD.search(pattern)
        fixed = pattern[: wild.start()] if wild else pattern
        for length in range(min(len(fixed), MAX_NAME) + 1) if self.prefixes else ():
            if fixed[:length] in self.prefixes:
                yield self.prefixes[fixed[:length]]
        if not wild:
            yield from (mark for other, mark in self.odd if SPEC.covers(other, pattern))


@dataclass(slots=True)
class Starts:
    """The starts of patterns, before the first wildcard: may two match the same name?"""

    fixed: list[str] = field(default_factory=list)
    """Sorted, so that equal prefixes are next to each other."""
    wild: set[str] = field(default_factory=set)
    """The starts of patterns with a wildcard."""

    def add(self, pattern: str) -> None:
        """Add a pattern."""
        start, is_wild = _start(pattern)
        insort(self.fixed, start)
        if is_wild:
            self.wild.add(start)

    def may_meet(self, pattern: str) -> bool:
        """Whether `pattern` and one of these may match the same name.

        The text after the first wildcard is ignored.
        """
        start, is_wild = _start(pattern)
        place = bisect_left(self.fixed, start)
        for near in self.fixed[place : place + 1]:
            if near == start or (is_wild and near.startswith(start)):
                return True
        lengths = range(min(len(start), MAX_NAME) + 1) if self.wild else ()
        return any(start[:length] in self.wild for length in lengths)


def _start(pattern: str) -> tuple[str, bool]:
    found = _WILD.search(pattern)
    return (pattern[: found.start()], True) if found else (pattern, False)


def domains_meet(one: DomainSet, other: DomainSet) -> bool:
    """Whether some domain is in both; True if there are too many parts to compare."""
    if len(one.parts) > ODD_PATTERNS or len(other.parts) > ODD_PATTERNS:
        return True
    return any(_overlap(part, each) for part in one.parts for each in other.parts)


def _overlap(part: int | DomainRange, other: int | DomainRange) -> bool:
    (first, last), (other_first, other_last) = _ends(part), _ends(other)
    return (last is None or other_first <= last) and (other_last is None or first <= other_last)


def covers_domains(earlier: DomainSet, later: DomainSet) -> bool:
    """Whether each part of `later` is within one part of `earlier`; False if too many parts."""
    if earlier == later or len(later.parts) > ODD_PATTERNS:
        return earlier == later
    return all(
        any(_within(part, other) for other in earlier.parts[:ODD_PATTERNS]) for part in later.parts
    )


def _within(part: int | DomainRange, other: int | DomainRange) -> bool:
    first, last = _ends(part)
    other_first, other_last = _ends(other)
    if other_first > first:
        return False
    return other_last is None or (last is not None and last <= other_last)


def _ends(part: int | DomainRange) -> tuple[int, int | None]:
    return (part.first, part.last) if isinstance(part, DomainRange) else (part, part)
