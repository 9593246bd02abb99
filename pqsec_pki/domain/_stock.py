"""`stock` of a domain file: who may be met with the first set of credentials."""

from collections.abc import Collection

from pqsec_pki.documents.parts_yaml import Item, one_or_more, refused, text
from pqsec_pki.domain._groups import Given, named
from pqsec_pki.domain._listing import regular, without_braces

MAX_STOCK = 1000
"""Names and patterns: each is in the configuration of each participant."""


def stock_in(item: Item) -> tuple[Given, ...]:
    """The names and patterns, each with its line; an empty list means nobody."""
    return one_or_more(item, lambda each: (text(each), each.line))


def stock_names(given: Collection[Given], participants: Collection[str]) -> tuple[str, ...]:
    """The names and patterns without braces, sorted. InvalidDocumentError with all mistakes.

    Each must be of a participant of the file: with a typing error it would refuse that one.
    """
    found: set[str] = set()
    for pattern, line in given:
        named(pattern, line, participants)
        for each in without_braces(pattern, line):
            found.add(f"/{each.lstrip('/')}" if "*" in each else regular(each, line))
        if len(found) > MAX_STOCK:
            raise refused(line, f"more than {MAX_STOCK} names: use patterns, such as /fleet/*")
    return tuple(sorted(found))
