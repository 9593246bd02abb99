"""Finds which of many names a pattern covers."""

from bisect import bisect_left
from collections.abc import Iterable

from pqsec_pki.access._patterns import SPECIAL, Covers, posix
from pqsec_pki.access._witnesses import is_plain

_LAST = "\U0010ffff"


class Names:
    """Sorted names: a pattern is compared only with names that begin as it does."""

    def __init__(self, names: Iterable[str]) -> None:
        self.sorted = sorted(set(names))
        self._all = frozenset(self.sorted)

    def covered_by(self, patterns: Iterable[str], covers: Covers = posix) -> set[str]:
        """The names that one of the patterns covers."""
        found = set[str]()
        for pattern in patterns:
            if not is_plain(pattern):
                found |= self.covered(pattern, covers)
            elif pattern in self._all:
                found.add(pattern)
        return found

    def covered(self, pattern: str, covers: Covers = posix) -> frozenset[str]:
        """The names that the pattern covers."""
        if is_plain(pattern):
            return self._all & {pattern}
        begin = "" if pattern[:1].isspace() else SPECIAL.split(pattern, maxsplit=1)[0].rstrip()
        first, last = bisect_left(self.sorted, begin), bisect_left(self.sorted, begin + _LAST)
        return frozenset(name for name in self.sorted[first:last] if covers(pattern, name))
