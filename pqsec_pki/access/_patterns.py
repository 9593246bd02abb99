"""Does a pattern cover a name? The fnmatch of each stack.

All compare UTF-8 octets, as fnmatch does in the C locale, and none holds `/` or a leading
`.` to be special. Cyclone DDS tries every way to share a name among `*`, so that a
pattern as `*a*a*a*a*b` can stop it for hours; here the time is linear in the pattern and in
the name, whatever they are.
"""

import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple, TypeAlias

from pqsec_pki.access._brackets import ANY, Bracket, cyclonedds_bracket, of, posix_bracket
from pqsec_pki.access._wild_match import reads_beyond, wild_match
from pqsec_pki.access.question import MAX_NAME

Covers: TypeAlias = Callable[[str, str], bool]
"""Whether a pattern covers a name, in that order."""

_CACHED = 1 << 14
"""Patterns kept: as many as the largest policies have."""
LONGEST = 4 * MAX_NAME
"""Octets of a name. A pattern that asks for more covers none."""
_STAR = -1
_SPECIAL = re.compile(r"[*?\[\\]")


def posix(pattern: str, name: str) -> bool:
    r"""fnmatch of POSIX as glibc has it, with `\` as escape and `[^` as `[!`."""
    return _covers(compiled, pattern, name)


def posix_without_escapes(pattern: str, name: str) -> bool:
    r"""The same with FNM_NOESCAPE: `\` is a character like others."""
    return _covers(_posix_without_escapes, pattern, name)


def either_way(pattern: str, name: str) -> bool:
    """StringMatching::matchString of Fast DDS: the name may be the pattern too (read)."""
    return posix_without_escapes(pattern, name) or posix_without_escapes(name, pattern)


def cyclonedds(pattern: str, name: str) -> bool:
    """ac_fnmatch of Cyclone DDS 0.10.2: no escapes, and brackets of its own (measured)."""
    return _covers(_cyclonedds, pattern, name)


class Compiled(NamedTuple):
    """A pattern as places: the one before the first character, and one after each.

    From a place a star leads back to it, and a character to the next, which is a shift
    in a set of places kept as the bits of a number.
    """

    length: int
    stars: int
    """The places with a star."""
    characters: dict[int, int]
    """For a set of octets, the places from which one of these leads on."""

    def covers(self, name: bytes) -> bool:
        if self.length > len(name):
            return False
        leads = {octet: self.leading(1 << octet) for octet in set(name)}
        reached = 1
        for octet in name:
            reached = (reached & self.stars) | (reached & leads[octet]) << 1
        return bool(reached >> self.length & 1)

    def leading(self, octets: int) -> int:
        """The places from which one of these octets leads on."""
        places = 0
        for members, having in self.characters.items():
            if members & octets:
                places |= having
        return places

    @property
    def kinds(self) -> list[int]:
        """For each place but the last, the set of octets that leads on."""
        found = [0] * self.length
        for octets, having in self.characters.items():
            for place in bits(having):
                found[place] = octets
        return found


def bits(number: int) -> Iterator[int]:
    """The places of the ones."""
    while number:
        yield (number & -number).bit_length() - 1
        number &= number - 1


def _covers(compiling: Callable[[str], Compiled], pattern: str, name: str) -> bool:
    special = _SPECIAL.search(pattern)
    if special is None or not name.startswith(pattern[: special.start()]):
        return pattern == name  # as nearly all patterns of a large policy are
    return compiling(pattern).covers(_octets(name))


def _octets(text: str) -> bytes:
    return text.encode(errors="surrogatepass")


def _characters(text: str) -> str:
    """One for each octet."""
    return _octets(text).decode("latin-1")


def read(pattern: str) -> Compiled:
    """As `posix` reads it."""
    return _compiled(pattern, posix_bracket, escape="\\")


@lru_cache(_CACHED)
def compiled(pattern: str) -> Compiled:
    """The same, kept: for patterns of documents."""
    return read(pattern)


@lru_cache(_CACHED)
def _posix_without_escapes(pattern: str) -> Compiled:
    return _compiled(pattern, posix_bracket, escape="")


@lru_cache(_CACHED)
def _cyclonedds(pattern: str) -> Compiled:
    return _compiled(pattern, cyclonedds_bracket, escape="")


def _compiled(pattern: str, bracket: Bracket, escape: str) -> Compiled:
    place, stars, characters = 1, 0, dict[int, int]()
    for token in _tokens(_characters(pattern), bracket, escape):
        if token == _STAR:
            stars |= place
        else:
            characters[token] = characters.get(token, 0) | place
            place <<= 1
        if place >> (LONGEST + 1):
            break
    return Compiled(place.bit_length() - 1, stars, characters)


def _tokens(pattern: str, bracket: Bracket, escape: str) -> Iterator[int]:
    """A set of octets for each character of a name, and stars."""
    at = 0
    while at < len(pattern):
        character = pattern[at]
        at += 1
        if character == "*":
            yield _STAR
        elif character == "?":
            yield ANY
        elif character == "[" and (found := bracket(pattern, at, escape)):
            token, at = found
            yield token
        elif character == escape:
            yield of(pattern[at : at + 1])
            at += 1
        else:
            yield of(character)


def opendds(pattern: str, name: str) -> bool:
    r"""ACE::wild_match, with `\` as escape and `[!` but not `[^`."""
    special = _SPECIAL.search(pattern)
    if special is None or not name.startswith(pattern[: special.start()]):
        return pattern == name
    return wild_match(_characters(pattern), _characters(name))


def opendds_reads_beyond(pattern: str) -> bool:
    """Whether OpenDDS reads memory behind the pattern, since a bracket in it is open."""
    return reads_beyond(_characters(pattern))
