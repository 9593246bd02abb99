"""Subject names and criteria of grants: parsed, split as Cyclone DDS splits them, shown."""

import re
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache

from pqsec_pki.documents import Criteria, Grant, PermissionRule, Subject, parse_subject
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint.document import PermissionsFile

CUTS = re.compile("[,/|]")
"""Where Cyclone DDS splits a name, even at an escaped character."""


@lru_cache(maxsize=8192)
def parsed(text: str) -> Subject:
    """The parts of the subject name; none if `text` is not one."""
    try:
        return parse_subject(text)
    except PqsecError:
        return ()


def named(document: PermissionsFile) -> Iterator[tuple[Grant, Subject, list[Subject]]]:
    """(grant, its name, the reversed name if another grant has it), for each readable name."""
    names = [(grant, parsed(grant.subject_name)) for grant in document.grants]
    all_names = {name for _, name in names}
    for grant, name in names:
        if name:
            yield grant, name, [name[::-1]] if name[::-1] in all_names - {name} else []


def repeated(name: Subject) -> str | None:
    """The attribute type that several parts have; DC is not counted, as it often repeats."""
    counts = Counter(word for part in name for word, _ in part)
    return next((word for word, count in counts.items() if count > 1 and word != "DC"), None)


def shown(grant: Grant) -> str:
    """The grant's subject name, printable, for a message."""
    name = grant.subject_name[:80]
    return name if name.isprintable() else ascii(name)


def criteria_of(grant: Grant) -> Iterator[tuple[PermissionRule, str, Criteria]]:
    """(rule, publish or subscribe, criteria) for all that stacks check; they ignore relay."""
    for rule in grant.rules:
        for action in ("publish", "subscribe"):
            yield from ((rule, action, criteria) for criteria in getattr(rule, action))
