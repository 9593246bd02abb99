r"""Whether the partitions of an endpoint match those of a rule. Both sides are expressions.

The PARTITION QoS contains fnmatch expressions (DDS 1.4, 2.2.3.13), as the rules do (DDS-Security
1.1, 9.4.1.3.2.3). An endpoint in `s*` communicates in every partition that begins with s. So an
allow_rule must cover every name that the endpoint's expression covers; a deny_rule applies if
there is one name that both cover.

Stacks do not agree on brackets in a QoS: in Cyclone DDS `[ab]` is a name. In an expression of an
endpoint, everything from a `[` or `\` on is therefore taken as `*`.

To find out whether several expressions together cover another takes exponential time in the
worst case. Here the steps of one question are limited to MAX_STEPS. If the answer is not known
by then, an allow_rule does not match, and a deny_rule does.
"""

import re
from collections.abc import Iterable

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._brackets import ANY
from pqsec_pki.access._patterns import LONGEST, Compiled, compiled, read

MAX_STEPS = 50_000
"""Steps for one question, each with at most WORD places: about a tenth of a second, and 20 MB."""
WORD = 1024
"""Places of patterns, and so bits of a number, that one step handles."""

_UNSURE = re.compile(r"[\[\\].*", re.DOTALL)


@dataclass(slots=True)
class Budget:
    """How many steps are left for a question."""

    left: int = MAX_STEPS

    @property
    def spent(self) -> bool:
        """Whether the steps ran out, so that the answer is not certain."""
        return self.left < 0

    def take(self, places: int) -> bool:
        """Count one more step, for patterns of so many places; False if it is beyond the limit."""
        if self.spent:
            return False
        self.left -= 1 + places // WORD
        return not self.spent


def within(expression: str, patterns: Iterable[str], budget: Budget) -> bool:
    """Whether the patterns together cover every name that the expression covers.

    False if the steps run out. It visits sets of places of all patterns, one for each way to
    read a name that the expression covers; `budget` limits their number, and so the memory.
    """
    if budget.spent:
        return False
    wanted = _of_endpoint(expression)
    near = [each for each in map(compiled, patterns) if each.length <= LONGEST]
    near = [each for each in near if _meet(wanted, each, budget)]
    return _all_covered(wanted, near, budget)


def meets(expression: str, patterns: Iterable[str], budget: Budget) -> bool:
    """Whether there is a name that the expression and one of the patterns cover.

    True if the steps run out. It takes a few steps for each place of the expression and pattern.
    """
    if budget.spent:
        return True
    wanted = _of_endpoint(expression)
    return any(_meet(wanted, each, budget) for each in map(compiled, patterns))


def said(expression: str) -> str:
    """The expression in quotes, with the expression that it is taken for if that differs."""
    taken = _UNSURE.sub("*", expression)
    return f"{expression!r}" if taken == expression else f"{expression!r} (taken for {taken!r})"


def _of_endpoint(expression: str) -> Compiled:
    return read(_UNSURE.sub("*", expression))  # not cached: a peer may send any number


def _meet(one: Compiled, other: Compiled, budget: Budget) -> bool:
    """Whether there is a name that both cover: keeps places of `other` for each place of `one`."""
    if other.characters.get(0):
        return False  # it needs a character of an empty set
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
    """Several patterns as one, their places in sequence, with their first and last places."""
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
    """Whether there is no name that `wanted` covers and none of the patterns covers."""
    union, start, ends = _union(patterns)
    kinds, choices = [*wanted.kinds, 0], _choices(wanted, union, budget)
    todo = [(0, start)]
    seen = set(todo)
    for place, reached in todo:  # grows; breadth first: a name that is not covered is often short
        if not reached or (place == wanted.length and not reached & ends):
            return False
        if reached & ends & union.stars:
            continue  # everything that follows is covered
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
    """The sets of octets that no pattern distinguishes, each with the places that it leads from."""
    parts = [ANY]
    for kind in {*wanted.characters, *union.characters}:
        if budget.take(0):
            parts = [part for each in parts for part in (each & kind, each & ~kind) if part]
    return [
        (part, union.leading(part))
        for part in parts
        if budget.take(union.length * len(union.characters))
    ]
