"""Reads the ledger's history: lines of one kind that one command wrote are one event."""

from collections.abc import Iterable, Iterator
from itertools import groupby

from pqsec_pki.keystore import Line
from pqsec_pki.report.values import LedgerEvent

_WORDS = {
    "identity-ca": "created an identity CA",
    "permissions-ca": "created a permissions CA",
    "governance": "signed the governance",
    "permissions": "signed permissions",
    "crl": "issued a revocation list",
    "trust": "changed which identity CAs are trusted",
    "revocation": "revoked",
    "compromise": "marked as compromised",
    "receipt": "recorded what a robot installed",
}
ISSUED = "issued"
RENEWED = "renewed"


def events_of(lines: Iterable[Line], *, after: int = 0) -> tuple[LedgerEvent, ...]:
    """The events after that number of lines, the oldest first.

    A participant's first certificate of a set of credentials is issued, others are renewed.
    """
    told = [each for each in _told(lines) if each[1] > after]
    events = []
    for (at, operator, what), group in groupby(told, key=lambda each: each[0]):
        alike = list(group)
        events.append(
            LedgerEvent(
                first=alike[0][1],
                at=at,
                operator=operator,
                what=what,
                names=tuple(dict.fromkeys(name for _, _, name in alike if name)),
            )
        )
    return tuple(events)


def _told(lines: Iterable[Line]) -> Iterator[tuple[tuple[str, str, str], int, str]]:
    """(when, who, what), the line's number and the name; lines of one moment sorted by kind."""
    known = set[tuple[str, str]]()
    for _, batch in groupby(lines, key=lambda line: (line.entry.at, line.entry.operator)):
        found = []
        for line in batch:
            entry = line.entry
            what = _WORDS.get(entry.kind, entry.kind)
            if entry.kind == "participant":
                one = entry.set_name, entry.name
                what = RENEWED if one in known else ISSUED
                known.add(one)
            if reason := entry.details.get("reason", ""):
                what = f"{what} ({reason})"
            found.append(((entry.at, entry.operator or "", what), line.number, entry.name))
        order = list(dict.fromkeys(key for key, *_ in found))
        yield from sorted(found, key=lambda each: (order.index(each[0]), each[1]))
