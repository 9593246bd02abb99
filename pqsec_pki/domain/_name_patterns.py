"""Writes names of participants as patterns: /fleet/robot01 to /fleet/robot12 as robot{01..12}."""

import re
from collections.abc import Iterable

_PARTS = re.compile(r"\{[^}]*\}|[0-9]+")
"""Braces that were made before, and numbers."""
_MAX_NUMBERS = 4
"""Numbers of a name, from its end, that become ranges."""
_MAX_DIGITS = 9
"""The limit of the patterns that domain.yaml reads."""


def patterns_of(names: Iterable[str]) -> list[str]:
    """The fewest patterns found that give exactly these names, each once; sorted."""
    found, before = sorted(set(names)), 0
    while len(found) != before:
        before = len(found)
        for place in range(_MAX_NUMBERS):
            found = sorted(_counted(found, place))
    return found


def _counted(patterns: list[str], place: int) -> list[str]:
    """The patterns with ranges for consecutive numbers; `place` 0 is the last number of each."""
    numbers: dict[tuple[str, str], list[str]] = {}
    kept: list[str] = []
    for pattern in patterns:
        plain = [each for each in _PARTS.finditer(pattern) if each[0][0] != "{"]
        if place < len(plain) and len(plain[-1 - place][0]) <= _MAX_DIGITS:
            found = plain[-1 - place]
            around = pattern[: found.start()], pattern[found.end() :]
            numbers.setdefault(around, []).append(found[0])
        else:
            kept.append(pattern)
    for (before, after), texts in numbers.items():
        kept += [f"{before}{each}{after}" for each in _ranges(texts)]
    return kept


def _ranges(texts: list[str]) -> list[str]:
    """The numbers, with {first..last} for those that follow each other with the same padding."""
    left = set(texts)
    found: list[str] = []
    for first in sorted(texts, key=lambda each: (int(each), each)):
        if first not in left:
            continue
        last, width = first, len(first) if first.startswith("0") else 1
        while last in left:
            left.remove(last)
            end, last = last, f"{int(last) + 1:0{width}}"
        found.append(first if end == first else f"{{{first}..{end}}}")
    return found
