"""Whether a pattern covers a name by fnmatch of glibc in the locale C.UTF-8.

There `?` and `[!a]` cover a character, in the C locale (`_patterns`) an octet: é has two. What does
not match by characters is compared by octets too (measured, 2.36 and 2.41), so a pattern covers in
C.UTF-8 all that it covers in C. Classes such as `[:alpha:]` have the letters of all scripts; for
combining marks, Python's tables differ from those of glibc. In other UTF-8 locales ranges follow
the alphabetical order there, which is not known here.
"""

import unicodedata
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

from pqsec_pki.access import _patterns
from pqsec_pki.access._brackets import CLASSES, Member, posix_members
from pqsec_pki.access._patterns import SPECIAL
from pqsec_pki.access.question import MAX_NAME

_CACHED = 1 << 12
_NO_BREAK = "\u00a0\u2007\u202f"
"""Spaces at which no line may break: glibc counts them as printed."""
_SEPARATORS = frozenset({"Zs", "Zl", "Zp"})


class _Kind(NamedTuple):
    """The characters that lead from one place of a pattern to the next."""

    negated: bool
    members: tuple[Member, ...] = ()

    def has(self, character: str) -> bool:
        return self.negated is not any(_is_in(character, each) for each in self.members)


_ANY = _Kind(negated=True)


class _Places(NamedTuple):
    """A pattern as an automaton, as `_patterns.Compiled`; a star leads from a place to itself."""

    stars: int
    kinds: tuple[_Kind, ...]

    def covers(self, name: str) -> bool:
        if len(self.kinds) > len(name):
            return False
        leads = {character: self._leading(character) for character in set(name)}
        reached = 1
        for character in name:
            reached = (reached & self.stars) | (reached & leads[character]) << 1
        return bool(reached >> len(self.kinds) & 1)

    def _leading(self, character: str) -> int:
        return sum(1 << place for place, kind in enumerate(self.kinds) if kind.has(character))


def posix(pattern: str, name: str) -> bool:
    r"""fnmatch in C.UTF-8, with `\` as escape and `[^` as `[!`."""
    return _patterns.posix(pattern, name) or _covers(pattern, name, "\\")


def posix_without_escapes(pattern: str, name: str) -> bool:
    r"""fnmatch in C.UTF-8 with FNM_NOESCAPE: `\` is an ordinary character."""
    return _patterns.posix_without_escapes(pattern, name) or _covers(pattern, name, "")


def either_way(pattern: str, name: str) -> bool:
    """StringMatching::matchString of Fast DDS: either argument may be the pattern (read)."""
    return posix_without_escapes(pattern, name) or posix_without_escapes(name, pattern)


def _covers(pattern: str, name: str, escape: str) -> bool:
    special = SPECIAL.search(pattern)
    if special is None or not name.startswith(pattern[: special.start()]):
        return False  # as by octets
    return _compiled(pattern, escape).covers(name)


@lru_cache(_CACHED)
def _compiled(pattern: str, escape: str) -> _Places:
    stars, kinds = 0, list[_Kind]()
    for kind in _tokens(pattern, escape):
        if kind is None:
            stars |= 1 << len(kinds)
        else:
            kinds.append(kind)
        if len(kinds) > MAX_NAME:
            break  # it covers no name
    return _Places(stars, tuple(kinds))


def _tokens(pattern: str, escape: str) -> Iterator[_Kind | None]:
    """The characters of each place; None for a star."""
    at = 0
    while at < len(pattern):
        character = pattern[at]
        at += 1
        if character == "*":
            yield None
        elif character == "?":
            yield _ANY
        elif character == "[" and (found := posix_members(pattern, at, escape)):
            negated, members, at = found
            yield _Kind(negated, members)
        elif character == escape:
            yield _one(pattern[at : at + 1])
            at += 1
        else:
            yield _one(character)


def _one(character: str) -> _Kind:
    return _Kind(negated=False, members=((character, character),) if character else ())


def _is_in(character: str, member: Member) -> bool:
    if isinstance(member, tuple):
        return member[0] <= character <= member[1]
    if character.isascii():
        return character in CLASSES[member]
    return _BEYOND_ASCII[member](character)


def _is_word(character: str) -> bool:
    return character.isalpha() or unicodedata.category(character) in {"Nl", "Nd"}


def _is_printed(character: str) -> bool:
    return unicodedata.category(character) not in {"Cc", "Cn", "Cs", "Zl", "Zp"}


def _is_space(character: str) -> bool:
    return unicodedata.category(character) in _SEPARATORS and character not in _NO_BREAK


def _is_case(character: str, has_case: Callable[[str], bool]) -> bool:
    return has_case(character) or unicodedata.category(character) == "Lt"


def _is_graph(character: str) -> bool:
    return _is_printed(character) and not _is_space(character)


_BEYOND_ASCII: Mapping[str, Callable[[str], bool]] = {
    "alnum": _is_word,
    "alpha": _is_word,
    "blank": lambda character: _is_space(character) and unicodedata.category(character) == "Zs",
    "cntrl": lambda character: unicodedata.category(character) in {"Cc", "Zl", "Zp"},
    "digit": lambda _: False,
    "graph": _is_graph,
    "lower": lambda character: _is_case(character, str.islower),
    "print": _is_printed,
    "punct": lambda character: _is_graph(character) and not _is_word(character),
    "space": _is_space,
    "upper": lambda character: _is_case(character, str.isupper),
    "xdigit": lambda _: False,
}
"""Whether a character that is not ASCII is in the class."""
