"""Patterns of participants' names: `*` is any characters except `/`, `**` any characters."""

import re
from functools import lru_cache

_PARTS = {"**": ".*", "*": "[^/]*"}


def is_pattern(text: str) -> bool:
    """Whether it is for several names; a participant's name has no `*`."""
    return "*" in text


def whole(text: str) -> str:
    """The name or pattern as it is compared: from the root of all names."""
    return text if text.startswith("/") else f"/{text}"


def covers(pattern: str, name: str) -> bool:
    """Whether the pattern covers that name."""
    return bool(_compiled(whole(pattern)).fullmatch(name))


@lru_cache(maxsize=1024)
def _compiled(pattern: str) -> re.Pattern[str]:
    pieces = re.split(r"(\*\*?)", pattern)
    return re.compile("".join(_PARTS.get(each) or re.escape(each) for each in pieces))
