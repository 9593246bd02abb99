"""Whether a pattern covers a name, by the fnmatch of each stack.

All compare UTF-8 octets, as fnmatch does in the C locale (in UTF-8 locales: `_characters`). `/` and
a leading `.` are not special.
Cyclone DDS tries every way to divide a name among `*`, so a pattern such as `*a*a*a*a*b` can
stop it for hours. Here the time is always linear in the pattern and in the name.
"""

import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple, TypeAlias

from pqsec_pki.access._brackets import ANY, Bracket, cyclonedds_bracket, of, posix_bracket
from pqsec_pki.access._wild_match import reads_beyond, wild_match
from pqsec_pki.access.question import MAX_NAME

Covers: TypeAlias = Callable[[str, str], bool]
"""Arguments: a pattern and a name. Whether the pattern covers the name."""

_CACHED = 1 << 14
"""Cached patterns: as many as the largest policies have."""
LONGEST = 4 * MAX_NAME
"""Octets of a name. A pattern that needs more covers no name."""
_STAR = -1
_SPACE = " \t\v\r\n"
SPECIAL = re.compile(r"[*?\[\\]")
# ?, [!a], [[:alpha:]] and [é]. It stops at the next [, so that the search takes linear time.
_OF_LOCALE = re.compile(r"\?|\[(?:[!^]|\]?[\x00-Z\\^-\x7f]*+(?:\[[:.=]|[^\x00-\x7f]))")


def posix(pattern: str, name: str) -> bool:
    r"""fnmatch of POSIX as glibc has it, with `\` as escape and `[^` as `[!`."""
    return _covers(compiled, pattern, name)


def posix_without_escapes(pattern: str, name: str) -> bool:
    r"""fnmatch of POSIX with FNM_NOESCAPE: `\` is an ordinary character."""
    return _covers(_posix_without_escapes, pattern, name)


def fastdds(pattern: str, name: str) -> bool:
    """As Fast DDS 2.9.1 reads permissions: its XML parser reads white space alone as nothing."""
    return posix_without_escapes(pattern if pattern.strip(_SPACE) else "", name)


def either_way(pattern: str, name: str) -> bool:
    """StringMatching::matchString of Fast DDS: either argument may be the pattern (read)."""
    return posix_without_escapes(pattern, name) or posix_without_escapes(name, pattern)


def cyclonedds(pattern: str, name: str) -> bool:
    """ac_fnmatch of Cyclone DDS 0.10.2: no escapes, and brackets of its own (measured).

    Its XML parser removes the white space around each value.
    """
    return _covers(_cyclonedds, pattern.strip(_SPACE), name)


def follows_locale(pattern: str) -> bool:
    """Whether fnmatch covers other names in a UTF-8 locale (`_characters`) than in C."""
    return _OF_LOCALE.search(pattern) is not None


class Compiled(NamedTuple):
    """A pattern as an automaton: its states are the place before the first character and
    the place after each.

    A star leads from a place to the same place, a character to the next one. A set of places is
    an integer with a bit for each, so a step is a shift.
    """

    length: int
    stars: int
    """The places with a star."""
    characters: dict[int, int]
    """For each set of octets, the places from which one of them leads to the next place."""

    def covers(self, name: bytes) -> bool:
        if self.length > len(name):
            return False
        leads = {octet: self.leading(1 << octet) for octet in set(name)}
        reached = 1
        for octet in name:
            reached = (reached & self.stars) | (reached & leads[octet]) << 1
        return bool(reached >> self.length & 1)

    def leading(self, octets: int) -> int:
        """The places from which one of these octets leads to the next place."""
        places = 0
        for members, having in self.characters.items():
            if members & octets:
                places |= having
        return places

    @property
    def kinds(self) -> list[int]:
        """For each place but the last, the set of octets that lead to the next place."""
        found = [0] * self.length
        for octets, having in self.characters.items():
            for place in bits(having):
                found[place] = octets
        return found


def bits(number: int) -> Iterator[int]:
    """The positions of the 1 bits."""
    while number:
        yield (number & -number).bit_length() - 1
        number &= number - 1


def _covers(compiling: Callable[[str], Compiled], pattern: str, name: str) -> bool:
    special = SPECIAL.search(pattern)
    if special is None or not name.startswith(pattern[: special.start()]):
        return pattern == name  # nearly all patterns of a large policy are plain names
    if pattern[special.start() :] == "*" and len(pattern) <= MAX_NAME:
        return True  # and nearly all others are a prefix
    return compiling(pattern).covers(_octets(name))


def _octets(text: str) -> bytes:
    return text.encode(errors="surrogatepass")


def _characters(text: str) -> str:
    """One character for each octet."""
    return _octets(text).decode("latin-1")


def read(pattern: str) -> Compiled:
    """The pattern as fnmatch of POSIX reads it."""
    return _compiled(pattern, posix_bracket, escape="\\")


@lru_cache(_CACHED)
def compiled(pattern: str) -> Compiled:
    """Like `read`, cached: for patterns of documents."""
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
    """The pattern's tokens: a set of octets for each character of a name, and stars."""
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
    special = SPECIAL.search(pattern)
    if special is None or not name.startswith(pattern[: special.start()]):
        return pattern == name
    return wild_match(_characters(pattern), _characters(name))


def opendds_reads_beyond(pattern: str) -> bool:
    """Whether OpenDDS reads memory beyond the pattern because a bracket in it is not closed."""
    return reads_beyond(_characters(pattern))
