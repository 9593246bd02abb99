"""Sets of topics, or of partitions, expressed with the patterns of the documents."""

from collections.abc import Iterable, Iterator
from enum import StrEnum

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._index import Names
from pqsec_pki.access._witnesses import is_wildcard, witnesses

MOST_SAID = 6
"""Most exceptions to a pattern that a sentence names."""


class Extent(StrEnum):
    """How many of a pattern's names are meant."""

    ONE = "one"
    ALL = "all"
    SOME = "some"
    OTHER = "other"


@dataclass(frozen=True, slots=True, kw_only=True)
class Topics:
    """A topic, all or some topics that a pattern covers, or the topics that no pattern covers.

    Or partitions; the default partition has an empty name.
    """

    name: str
    """The topic or the pattern; empty for topics that no pattern covers."""
    extent: Extent
    such_as: str = ""
    but: tuple[str, ...] = ()
    """Patterns whose topics are not meant."""
    what: str = "topic"

    def __str__(self) -> str:
        name = self._text(self.name)
        words = {
            Extent.ONE: name,
            Extent.ALL: f"every {self.what}" if self.name == "*" else f"all of {name}",
            Extent.SOME: f"some of {name}, such as {_quoted(self.such_as)}",
            Extent.OTHER: f"{self.what}s that no rule names, such as {_quoted(self.such_as)}",
        }[self.extent]
        but = _few(map(self._text, self.but))
        return f"{words}, but none of {' and '.join(but)}" if but else words

    @property
    def short(self) -> str:
        """The name or pattern without `what`, for a cell of a table."""
        if not self.such_as:
            return self.name
        but = f" but not {' or '.join(_few(self.but))}" if self.but else ""
        return f"{self.name or 'others'}{but} (such as {self.such_as})"

    def to_json(self) -> dict[str, object]:
        """The fields; `such_as` is a name, or None."""
        return {
            "name": self.name,
            "extent": self.extent.value,
            "such_as": self.such_as or None,
            "but": list(self.but),
        }

    def _text(self, name: str) -> str:
        if self.what == "topic":
            return f"'{name}'"
        return f"{self.what} '{name}'" if name else f"the default {self.what}"


class SampleNames:
    """Names of topics (or of `what`): one for each set of patterns that can cover a name.

    If it is not `complete`, some topic may be covered by a set of patterns for which there is
    no name here; then nothing is claimed of all topics of a pattern. `also` are further names.
    """

    def __init__(
        self, patterns: Iterable[str], what: str = "topic", also: tuple[str, ...] = ()
    ) -> None:
        each = tuple(dict.fromkeys([*also, *patterns]))
        found = witnesses(each)
        self.names, self.complete = (*also, *found.names), found.complete
        self._what = what
        known = Names(self.names)
        self.covered = {pattern: known.covered(pattern) for pattern in each}
        self._literals = {pattern for pattern in each if not is_wildcard(pattern)}
        wildcards = (pattern for pattern in each if is_wildcard(pattern))
        self._wildcards = sorted(wildcards, key=lambda each: -len(self.covered[each]))
        self._covering: dict[str, list[str]] = {}
        """The wildcard patterns that cover each name, the widest first."""
        for pattern in self._wildcards:
            for name in self.covered[pattern]:
                self._covering.setdefault(name, []).append(pattern)

    def covered_by(self, patterns: Iterable[str]) -> frozenset[str]:
        """The names that one of the patterns covers."""
        return frozenset[str]().union(*(self.covered[pattern] for pattern in patterns))

    def described(self, chosen: frozenset[str]) -> tuple[Topics, ...]:
        """The `chosen` names, described in few words."""
        return tuple(self._described(chosen))

    def _described(self, chosen: frozenset[str]) -> Iterator[Topics]:
        left = set(chosen)
        for pattern in self._wildcards if self.complete else ():
            covered = self.covered[pattern]
            if covered <= chosen and covered & left:
                yield Topics(name=pattern, extent=Extent.ALL, what=self._what)
                left -= covered
        for name in self.names:
            if name in left and name in self._literals:
                yield Topics(name=name, extent=Extent.ONE, what=self._what)
                left.discard(name)
        yield from self._parts(chosen, left)

    def _parts(self, chosen: frozenset[str], left: set[str]) -> Iterator[Topics]:
        """The names that are left, by patterns that are not wholly chosen, the narrowest first."""
        for pattern in reversed(self._wildcards):
            if found := self.covered[pattern] & left:
                left -= found
                yield Topics(
                    name=pattern,
                    extent=Extent.SOME,
                    such_as=_shortest(found),
                    but=tuple(self._but(pattern, chosen)) if self.complete else (),
                    what=self._what,
                )
        if left:
            yield Topics(name="", extent=Extent.OTHER, such_as=_shortest(left), what=self._what)

    def _but(self, pattern: str, chosen: frozenset[str]) -> Iterator[str]:
        """The widest patterns within `pattern`, or else names, of which nothing is chosen."""
        within = self.covered[pattern]
        left = set(within - chosen)
        others = dict.fromkeys(other for name in left for other in self._covering[name])
        wider_first = sorted(others, key=lambda other: (-len(self.covered[other]), other))
        for other in [*wider_first, *sorted(left & self._literals)]:
            covered = self.covered[other]
            if covered & left and covered < within and not covered & chosen:
                yield other
                left -= covered


def _few(names: Iterable[str]) -> list[str]:
    some = list(names)
    if len(some) > MOST_SAID:
        some[MOST_SAID - 1 :] = [f"{len(some) - MOST_SAID + 1} more"]
    return some


def _quoted(name: str) -> str:
    return f"'{name}'" if name.isprintable() else ascii(name)


def _shortest(names: Iterable[str]) -> str:
    return min(names, key=lambda name: (len(name), name))
