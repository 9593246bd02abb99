r"""Are the partitions of an endpoint among those of a rule? Both sides are expressions.

The PARTITION QoS holds fnmatch expressions (DDS 1.4, 2.2.3.13), as the rules do
(DDS-Security 1.1, 9.4.1.3.2.3). An endpoint in `s*` talks to all in a partition that begins
with s, so a name is not enough: allowed is what lies within the expressions of a rule,
denied what meets one of them.

Stacks do not agree on brackets in a QoS: Cyclone DDS has none there, and `[ab]` is a name.
What begins with `[` or `\` in an expression of an endpoint is therefore taken for a `*`: it may
stand for anything.

Whether an expression lies within several others is a question that takes exponential time in
the worst case. Here the steps are counted, and those of one question end at MAX_STEPS. What
is not known by then is not allowed, and is denied.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from pqsec_pki.access._brackets import ANY
from pqsec_pki.access._patterns import LONGEST, Compiled, compiled, read

MAX_STEPS = 50_000
"""Steps for one question, each of at most WORD places: about a tenth of a second, and 20 MB."""
WORD = 1024
"""Places of patterns that one step moves: numbers of as many bits."""

_UNSURE = re.compile(r"[\[\\].*", re.DOTALL)


@dataclass(slots=True)
class Budget:
    """How many steps are left for a question."""

    left: int = MAX_STEPS

    @property
    def spent(self) -> bool:
        """Whether the answer is one in doubt."""
        return self.left < 0

    def take(self, places: int) -> bool:
        """Whether there was one more, of patterns with so many places."""
        if self.spent:
            return False
        self.left -= 1 + places // WORD
        return not self.spent


def within(expression: str, patterns: Iterable[str], budget: Budget) -> bool:
    """Whether each name that the expression covers is covered by one of the patterns.

    False in doubt. Subsets of the places of all patterns are walked through, one for each
    way in which a name that the expression covers can be read: `budget` bounds their number,
    and with it the memory.
    """
    if budget.spent:
        return False
    wanted = _of_endpoint(expression)
    near = [each for each in map(compiled, patterns) if each.length <= LONGEST]
    near = [each for each in near if _meet(wanted, each, budget)]
    return _all_covered(wanted, near, budget)


def meets(expression: str, patterns: Iterable[str], budget: Budget) -> bool:
    """Whether a name is covered by the expression and by one of the patterns.

    True in doubt. It takes a step or a few for each place of the expression and each pattern.
    """
    if budget.spent:
        return True
    wanted = _of_endpoint(expression)
    return any(_meet(wanted, each, budget) for each in map(compiled, patterns))


def said(expression: str) -> str:
    """The expression in quotes, with a word on what it is taken for, if that is not plain."""
    taken = _UNSURE.sub("*", expression)
    return f"{expression!r}" if taken == expression else f"{expression!r} (taken for {taken!r})"


def _of_endpoint(expression: str) -> Compiled:
    return read(_UNSURE.sub("*", expression))  # and not kept: a peer may send any number


def _meet(one: Compiled, other: Compiled, budget: Budget) -> bool:
    """Whether a name is covered by both: the places of the other, for each place of the one."""
    if other.characters.get(0):
        return False  # it asks for a character of which there is none
    kinds, reached = one.kinds, 1
    for place in range(one.length + 1):
        if not budget.take(other.length * len(other.characters)):
            return True
        if one.stars >> place & 1:
            reached |= (2 << other.length) - (reached & -reached)  # the lowest, and all above
        if place < one.length:
            reached = (reached & other.stars) | (reached & other.leading(kinds[place])) << 1
        if not reached:
            return False
    return bool(reached >> other.length & 1)


def _union(patterns: Iterable[Compiled]) -> tuple[Compiled, int, int]:
    """Several patterns as one, their places one behind the other, with their starts and ends."""
    start = ends = stars = length = 0
    characters: dict[int, int] = {}
    for each in patterns:
        start |= 1 << length
        ends |= 1 << (length + each.length)
        stars |= each.stars << length
        for octets, having in each.characters.items():
            characters[octets] = characters.get(octets, 0) | having << length
        length += each.length + 1
    return Compiled(length, stars, characters), start, ends


def _all_covered(wanted: Compiled, patterns: Iterable[Compiled], budget: Budget) -> bool:
    """Whether no name leads `wanted` to its end, and none of the patterns."""
    union, start, ends = _union(patterns)
    kinds, choices = [*wanted.kinds, 0], _choices(wanted, union, budget)
    todo = [(0, start)]
    seen = set(todo)
    for place, reached in todo:  # grows: breadth first, as a name that is missing is often short
        if not reached or (place == wanted.length and not reached & ends):
            return False
        if reached & ends & union.stars:
            continue  # whatever follows is covered
        for octets, leading in choices:
            if not budget.take(union.length):
                return False
            after = (reached & union.stars) | (reached & leading) << 1
            found = [(place, after)] if wanted.stars >> place & 1 else []
            found += [(place + 1, after)] if octets & kinds[place] else []
            todo += (each for each in found if each not in seen)
            seen.update(found)
    return not budget.spent


def _choices(wanted: Compiled, union: Compiled, budget: Budget) -> list[tuple[int, int]]:
    """The sets of octets that nothing tells apart, and the places that each leads on from."""
    parts = [ANY]
    for kind in {*wanted.characters, *union.characters}:
        if budget.take(0):
            parts = [part for each in parts for part in (each & kind, each & ~kind) if part]
    return [
        (part, union.leading(part))
        for part in parts
        if budget.take(union.length * len(union.characters))
    ]
