"""Bracket expressions of patterns, as each stack reads them.

A set of octets is an integer of 256 bits. A reader takes the pattern and the place after the
`[`. It returns the set and the place after the `]`, or None if the bracket is not closed.
"""

import re
import string
from collections.abc import Callable
from typing import TypeAlias

Bracket: TypeAlias = Callable[[str, int, str], tuple[int, int] | None]
"""A reader of brackets: takes the pattern, the place, and the escape character or an empty text."""

Member: TypeAlias = tuple[str, str] | str
"""The first and last character of a range, or the name of a class."""

ANY = (1 << 256) - 1

_PRINTED = string.ascii_letters + string.digits + string.punctuation
CLASSES = {
    "alnum": string.ascii_letters + string.digits,
    "alpha": string.ascii_letters,
    "blank": " \t",
    "cntrl": "".join(map(chr, range(32))) + "\x7f",
    "digit": string.digits,
    "graph": _PRINTED,
    "lower": string.ascii_lowercase,
    "print": _PRINTED + " ",
    "punct": string.punctuation,
    "space": string.whitespace,
    "upper": string.ascii_uppercase,
    "xdigit": string.hexdigits,
}
_CLASS = re.compile(r"\[:(?P<name>[a-y]+):\]")
_SYMBOL = re.compile(r"\[\.(?P<character>.)\.\]", re.DOTALL)
_ALIKE = re.compile(r"\[=(?P<character>.)=\]", re.DOTALL)  # in the C locale: only itself


def of(characters: str) -> int:
    """The set of these characters."""
    found = 0
    for character in characters:
        found |= 1 << ord(character)
    return found


def between(low: str, high: str) -> int:
    """The set of all characters from `low` to `high`; empty if `high` is less."""
    return max(0, (2 << ord(high)) - (1 << ord(low)))


def posix_bracket(pattern: str, place: int, escape: str) -> tuple[int, int] | None:
    """The bracket as glibc reads it in the C locale."""
    found = posix_members(pattern, place, escape)
    if found is None:
        return None
    negated, parts, end = found
    members = 0
    for each in parts:
        members |= of(CLASSES[each]) if isinstance(each, str) else between(*each)
    return members ^ (ANY * negated), end


def posix_members(
    pattern: str, place: int, escape: str
) -> tuple[bool, tuple[Member, ...], int] | None:
    """Whether the bracket is negated, its members, and the place after it, as glibc reads it.

    Without the collating symbols of other locales. None if it is not closed.
    """
    negated = pattern.startswith(("!", "^"), place)
    place += negated
    begin, members = place, list[Member]()
    while place < len(pattern):
        if pattern[place] == "]" and place > begin:
            return negated, tuple(members), place + 1
        found = _posix_member(pattern, place, escape)
        if found is None:
            return False, (), len(pattern)  # with [[:nonsense:]] the whole pattern covers nothing
        members.append(found[0])
        place = found[1]
    return None


def _posix_member(pattern: str, place: int, escape: str) -> tuple[Member, int] | None:
    """A class, a range or a character; None for an unknown class."""
    if named := _CLASS.match(pattern, place):
        return (named["name"], named.end()) if named["name"] in CLASSES else None
    if alike := _ALIKE.match(pattern, place):
        return (alike["character"], alike["character"]), alike.end()
    low, place = _character(pattern, place, escape)
    if pattern.startswith("-", place) and pattern[place + 1 : place + 2] not in ("", "]"):
        high, place = _character(pattern, place + 1, escape)
        return (low, high), place
    return (low, low), place


def _character(pattern: str, place: int, escape: str) -> tuple[str, int]:
    if symbol := _SYMBOL.match(pattern, place):
        return symbol["character"], symbol.end()
    place += pattern[place] == escape and place + 1 < len(pattern)
    return pattern[place], place + 1


def cyclonedds_bracket(pattern: str, place: int, _escape: str) -> tuple[int, int]:
    """For Cyclone DDS `[^a]` is `^` or `a`; a bracket that is not closed covers nothing.

    It reads the closing `]` as a member first: `[ab]` also contains `]`, and `[0-9]-f` is one
    bracket, with the digits and `]` to `f`.
    """
    negated = pattern.startswith("!", place)
    place += negated
    closed, members = pattern.startswith("]", place), 0
    while not closed:
        character, following, high = (pattern[place + each : place + each + 1] for each in range(3))
        is_range = following == "-"
        if not character or (is_range and high in ("", "]")):
            return 0, len(pattern)
        members |= between(character, high) if is_range else of(character)
        place += 3 if is_range else 1
        closed = character == "]"
    return members ^ (ANY * negated), place
