"""Sample names: at least one for each set of patterns that together can cover a name.

A decision depends only on which patterns cover a name. So two policies that agree on one name
for each such set of patterns agree on every name. The sets are found with one automaton for all
patterns; its states are sets of places in the patterns.
"""

from collections.abc import Container, Iterable, Sequence
from string import ascii_letters, digits
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._patterns import SPECIAL, bits, compiled

MAX_WORK = 2_000_000
"""Places in all states, a second or two of work. With more, the names are not complete, because the
number of sets of patterns can be exponential."""

_State: TypeAlias = frozenset[int]
_OTHER = -1

_UNNAMED = 1
"""An octet that no pattern contains, because XML cannot. It distinguishes `?`, which covers it,
from `[ -~]`, which covers all printable ASCII."""

# Generated names are printable ASCII, and use the first of these characters that fits.
_PREFERRED = "".join(
    dict.fromkeys(f"xyzw{ascii_letters}{digits}_/-." + "".join(map(chr, range(32, 127))))
)


@dataclass(frozen=True, slots=True)
class Witnesses:
    """The names; `complete` if the same patterns cover any name in ASCII as cover one of these."""

    names: tuple[str, ...]
    complete: bool


def is_wildcard(pattern: str) -> bool:
    """Whether the pattern may cover other names than itself."""
    return SPECIAL.search(pattern) is not None


def is_plain(pattern: str) -> bool:
    """Whether it covers the name that it is and no other, in every reading.

    White space around it belongs to the name for some stacks, and not for others.
    """
    return not is_wildcard(pattern) and pattern == pattern.strip()


def witnesses(patterns: Iterable[str]) -> Witnesses:
    """Names for all sets of patterns that can cover a name, by fnmatch of POSIX."""
    each = dict.fromkeys(patterns)
    literals = [name for name in each if name and not is_wildcard(name)]
    wildcards = [pattern for pattern in each if is_wildcard(pattern)]
    found = _search(wildcards, literals)
    beyond = [each for each in wildcards if found is None or not each.isascii()]
    known = frozenset(literals)
    made = [name for pattern in beyond if (name := sample(pattern, known))]
    names = dict.fromkeys([*literals, *(found or ()), *made])
    return Witnesses(tuple(names), complete=found is not None)


def sample(pattern: str, but: Container[str] = ()) -> str | None:
    """A name that the pattern covers, if possible not in `but`; None if no simple one was found."""
    if not is_wildcard(pattern):
        return pattern or None
    made = [name for filler in ("x", "xyz", "") if (name := _filled(pattern, filler))]
    return next((name for name in made if name not in but), next(iter(made), None))


def _filled(pattern: str, filler: str) -> str | None:
    places = compiled(pattern)
    name = b""
    for place in range(places.length + 1):
        if places.stars >> place & 1:
            name += filler.encode()
        if place < places.length:
            octets = next(
                octets for octets, having in places.characters.items() if having >> place & 1
            )
            name += bytes(_first(octets))
    text = name.decode(errors="replace")
    return text if places.covers(text.encode()) else None


def _first(octets: int) -> list[int]:
    """The octet of the set that reads best in a name; empty for an empty set."""
    preferred = [ord(character) for character in _PREFERRED if octets >> ord(character) & 1]
    return preferred[:1] or [octet for octet in range(256) if octets >> octet & 1][:1]


def _search(wildcards: Sequence[str], literals: Sequence[str]) -> list[str] | None:
    """A name that is not a literal for each set of wildcards; None if there are too many sets.

    If the name found for a set is a literal, all literals of that set are added to the
    automaton; it then finds another name, or that there is none.
    """
    automaton, taken = _Automaton(wildcards), set(literals)
    found = automaton.names()
    if found is None:
        return None
    good = [name for name in found.values() if name not in taken]
    wanted = {met for met, name in found.items() if name in taken}
    if wanted:
        alike = [name for name in literals if automaton.read(name) in wanted]
        apart = _Automaton([*wildcards, *alike]).names()
        if apart is None:
            return None
        others = (name for name in apart.values() if name not in taken)
        good += [name for name in others if automaton.read(name) in wanted]
    return good


class _Automaton:
    """An automaton for all patterns. A state is a set of places in them."""

    def __init__(self, patterns: Sequence[str]) -> None:
        self._kinds: list[int] = []
        """For each place the octets that lead to the next; none at the end of a pattern."""
        start, stars, ends = list[int](), list[int](), list[int]()
        for pattern in patterns:
            places, first = compiled(pattern), len(self._kinds)
            self._kinds += [*places.kinds, 0]
            start.append(first)
            stars += (first + place for place in bits(places.stars))
            ends.append(first + places.length)
        self._start, self._stars, self._ends = map(frozenset, (start, stars, ends))
        self._alike = _alike(set(self._kinds))
        self._alphabet = sorted(set(self._alike.values()), key=list(self._alike).index)
        self._members: dict[int, list[int]] = {}
        self._known: dict[_State, dict[int, _State]] = {}

    def read(self, name: str) -> _State:
        """The patterns that cover a name, each as its last place."""
        state = self._start
        for octet in name.encode(errors="surrogatepass"):
            leads = self._leads(state)
            state = leads.get(self._alike.get(octet, _OTHER), leads[_OTHER])
        return state & self._ends

    def names(self) -> dict[_State, str] | None:
        """A name for each set of patterns that can cover one; None if there are too many."""
        seen, todo, found, work = set[_State](), [("", self._start)], dict[_State, str](), 0
        for word, state in todo:  # grows: breadth first, so that names are short
            leads = self._leads(state)
            work += sum(map(len, leads.values()))
            if work > MAX_WORK:
                return None
            for octet in self._alphabet:
                after = leads.get(octet, leads[_OTHER])
                if after not in seen:
                    seen.add(after)
                    todo.append((word + chr(octet), after))
                    self._keep(found, *todo[-1])
        return found

    def _keep(self, found: dict[_State, str], word: str, state: _State) -> None:
        met = state & self._ends
        if met not in found:
            longer = not word[-1].isalnum() and self.read(f"{word}x") == met
            found[met] = f"{word}x" if longer else word

    def _leads(self, state: _State) -> dict[int, _State]:
        """The next state for each octet; `_OTHER` for octets that lead no place to the next."""
        if state not in self._known:
            found: dict[int, list[int]] = {_OTHER: []}
            for place in state:
                for octet in self._octets(self._kinds[place]):
                    found.setdefault(octet, []).append(place + 1)
            stay = state & self._stars
            self._known[state] = {octet: stay.union(places) for octet, places in found.items()}
        return self._known[state]

    def _octets(self, kind: int) -> list[int]:
        """The octets of the alphabet that are in the set `kind`."""
        if kind not in self._members:
            self._members[kind] = [octet for octet in self._alphabet if kind >> octet & 1]
        return self._members[kind]


def _alike(kinds: Iterable[int]) -> dict[int, int]:
    """For each octet of generated names, the first octet that is in the same kinds."""
    first: dict[tuple[int, ...], int] = {}
    octets = [*map(ord, _PREFERRED), _UNNAMED]
    return {
        octet: first.setdefault(tuple(kind for kind in kinds if kind >> octet & 1), octet)
        for octet in octets
    }
