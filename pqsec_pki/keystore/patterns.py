"""Participants that users give several at once: patterns `/tb3/*`, `/tb3/**`, groups `@hall1`."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence

from pqsec_pki._name_patterns import covers, is_pattern, whole
from pqsec_pki.errors import MOST_MEANT, KeystoreError, meant, shown
from pqsec_pki.problems import Code

GROUP = "@"
"""Before the name of a group: neither a participant's name nor a serial number may have it."""


def is_several(name: str) -> bool:
    """Whether it is a pattern or a group, and not the name of one participant."""
    return is_pattern(name) or name.startswith(GROUP)


def expanded(
    names: Iterable[str], known: Sequence[str], groups: Mapping[str, Sequence[str]]
) -> list[str]:
    """The names, each once; for a pattern or a group those of `known` that it matches.

    `*` matches any characters except `/`, so `/tb3/*` are the nodes of a robot; `**` matches any
    characters. `groups` has the members of each group by its name without `@`. Names of single
    participants are not looked for. KeystoreError for a pattern that matches none, for an unknown
    group, and for a group with no member in `known`.
    """
    found: dict[str, None] = {}
    for name in names:
        if name.startswith(GROUP):
            found |= dict.fromkeys(_members(name, known, groups))
        elif is_several(name):
            found |= dict.fromkeys(_refusing_none(name, known))
        else:
            found[name] = None
    return list(found)


def matching(pattern: str, known: Iterable[str]) -> list[str]:
    """The names of `known` that the pattern matches, in their order."""
    return [name for name in known if covers(pattern, name)]


def _refusing_none(pattern: str, known: Sequence[str]) -> list[str]:
    found = matching(pattern, known)
    if not found:
        raise KeystoreError(
            f"no participant matches {shown(pattern)}",
            code=Code.FILE_MISSING,
            hint=nearest(pattern, known) or "`pqsec status` lists the participants",
        )
    return found


def nearest(name: str, known: Collection[str]) -> str:
    """What of `known` a name or pattern that is not among them may have meant, in words; or ''."""
    meant_name = whole(name)
    if not is_several(name):
        return _below(meant_name, known) or meant(meant_name, known)
    deeper = re.sub(r"\*+", "**", meant_name)
    if matching(deeper, known):
        return f"* stands for no /, and ** does: '{shown(deeper)}'"
    return meant(meant_name, known)


def _below(name: str, known: Iterable[str]) -> str:
    """The names of `known` below `name`, which is a robot, or the one that ends so; or ''."""
    names = sorted(known)
    below = [each for each in names if each.startswith(f"{name}/")]
    if len(below) > 1:
        nodes = f"{name}/*"
        pattern = nodes if len(matching(nodes, below)) == len(below) else f"{nodes}*"
        some = [*map(shown, below[:MOST_MEANT]), *["..."] * (len(below) > MOST_MEANT)]
        return f"did you mean '{shown(pattern)}' ({', '.join(some)})?"
    found = below or [each for each in names if each.endswith(name)]
    return f"did you mean {shown(found[0])!r}?" if len(found) == 1 else ""


def _members(
    group: str, known: Sequence[str], groups: Mapping[str, Sequence[str]]
) -> Iterable[str]:
    members = groups.get(group.removeprefix(GROUP))
    if members is None:
        all_groups = [f"{GROUP}{each}" for each in groups]
        raise KeystoreError(
            f"there is no group {shown(group)}",
            hint=meant(group, all_groups)
            or (f"the groups are {', '.join(all_groups[:_MOST])}" if groups else _NO_GROUPS),
        )
    there = set(known)
    found = [name for name in members if name in there]
    if not found:
        raise KeystoreError(
            f"no participant of the group {group} is here",
            hint="`pqsec plan` shows which participants of the domain file are not issued yet",
        )
    return found


_MOST = 8
"""Groups that a hint names."""
_NO_GROUPS = "there are none: `pqsec apply` stores those of the domain file in the keystore"
