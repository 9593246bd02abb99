"""Names of participants that users give as patterns: `/tb3/*`, `/tb3/**`."""

import re
from collections.abc import Iterable, Sequence

from pqsec_pki.errors import KeystoreError, meant, shown
from pqsec_pki.problems import Code

_PARTS = {"**": ".*", "*": "[^/]*"}


def is_pattern(name: str) -> bool:
    """Whether a name has a `*`, which no participant's name has."""
    return "*" in name


def expanded(names: Iterable[str], known: Sequence[str]) -> list[str]:
    """The names, with all of `known` that match it instead of each pattern; each once.

    `*` stands for any characters but `/`, so `/tb3/*` are the nodes of a robot, and `**` for any
    characters. Names that are not patterns are not looked for. KeystoreError for a pattern that
    matches none.
    """
    found: dict[str, None] = {}
    for name in names:
        found |= dict.fromkeys(_matching(name, known) if is_pattern(name) else [name])
    return list(found)


def _matching(pattern: str, known: Sequence[str]) -> list[str]:
    whole = pattern if pattern.startswith("/") else f"/{pattern}"
    pieces = re.split(r"(\*\*?)", whole)
    compiled = re.compile("".join(_PARTS.get(each) or re.escape(each) for each in pieces))
    found = [name for name in known if compiled.fullmatch(name)]
    if not found:
        raise KeystoreError(
            f"no participant matches {shown(pattern)}",
            code=Code.FILE_MISSING,
            hint=meant(whole, known) or "`pqsec status` lists the participants",
        )
    return found
