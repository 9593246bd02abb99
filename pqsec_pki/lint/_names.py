"""Subjects as rules look at them: read, cut as Cyclone DDS cuts them, shown in messages."""

import re
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache

from pqsec_pki.documents import Grant, Subject, parse_subject
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint.document import PermissionsFile

CUTS = re.compile("[,/|]")
"""Where Cyclone DDS cuts a name, be it escaped or not."""


@lru_cache(maxsize=8192)
def parsed(text: str) -> Subject:
    """Its parts; none if it is no name."""
    try:
        return parse_subject(text)
    except PqsecError:
        return ()


def named(document: PermissionsFile) -> Iterator[tuple[Grant, Subject, list[Subject]]]:
    """Each grant whose name can be read, with it, and turned round if another grant has that."""
    names = [(grant, parsed(grant.subject_name)) for grant in document.grants]
    all_names = {name for _, name in names}
    for grant, name in names:
        if name:
            yield grant, name, [name[::-1]] if name[::-1] in all_names - {name} else []


def repeated(name: Subject) -> str | None:
    """The word that two parts have, DC apart, which comes in several."""
    counts = Counter(word for part in name for word, _ in part)
    return next((word for word, count in counts.items() if count > 1 and word != "DC"), None)


def shown(grant: Grant) -> str:
    """Whose grant it is, fit for a message."""
    name = grant.subject_name[:80]
    return name if name.isprintable() else ascii(name)
