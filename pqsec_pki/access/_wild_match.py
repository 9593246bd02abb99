"""ACE::wild_match of ACE 7.0.8, which OpenDDS calls (measured).

Unlike fnmatch it does not go back in the name after a partial match, so `*ab` does not cover
`aab`. If a bracket is not closed, it reads memory beyond the pattern, and its answer is undefined
(run under AddressSanitizer, with ACE 6.2.1): `reads_beyond` finds such patterns.
"""

from pqsec_pki.access._brackets import ANY, between, of


def wild_match(pattern: str, name: str) -> bool:
    r"""Whether the pattern covers the name, with `\` as escape; a character is an octet."""
    at, place, after_star, escaped = 0, 0, -1, False
    while at < len(name):
        special = "" if escaped else pattern[place : place + 1]
        if special == "\\":
            place, escaped = place + 1, True
        elif special == "*":
            place = after_star = _after_stars(pattern, place)
            if place == len(pattern):
                return True
        else:
            met, place = _step(pattern, place, name[at], special)
            at, escaped = at + 1, False
            if not met and after_star < 0:
                return False
            place = place if met else after_star
    return _after_stars(pattern, place) == len(pattern)


def _step(pattern: str, place: int, character: str, special: str) -> tuple[bool, int]:
    """Whether the token at `place` covers the character, and the place after the token."""
    if special == "?":
        return True, place + 1
    if special != "[":
        return pattern[place : place + 1] == character, place + 1
    members, place = _bracket(pattern, place + 1) or (0, len(pattern))
    return bool(members >> ord(character) & 1), place


def _after_stars(pattern: str, place: int) -> int:
    while pattern.startswith("*", place):
        place += 1
    return place


def reads_beyond(pattern: str) -> bool:
    """Whether a bracket of the pattern is not closed."""
    place = 0
    while place < len(pattern):
        if pattern[place] == "[":
            found = _bracket(pattern, place + 1)
            if found is None:
                return True
            place = found[1]
        else:
            place += 2 if pattern[place] == "\\" else 1
    return False


def _bracket(pattern: str, place: int) -> tuple[int, int] | None:
    """The set of octets, and the place after the bracket; None if the bracket is not closed.

    If the end of a range is not greater than its begin, both are read as single characters.
    """
    negated = pattern.startswith("!", place)
    place += negated
    begin, members = place, 0
    while place < len(pattern):
        character, high = pattern[place], pattern[place + 1 : place + 2]
        if character == "]" and place > begin:
            return members ^ (ANY * negated), place + 1
        if character != "-" or place == begin or high == "]":
            members |= of(character)
        elif high > pattern[place - 1]:
            members |= between(pattern[place - 1], high)
            place += 1
        place += 1
    return None
