"""What ends when: certificates, the revocation list, and the grants of permissions."""

from collections import defaultdict
from collections.abc import Iterator
from datetime import date, datetime

from pqsec_pki.keystore import State, Status
from pqsec_pki.policy import Fleet
from pqsec_pki.report.values import Ending

KINDS = {
    "identity-ca": "identity CA",
    "permissions-ca": "permissions CA",
    "countersigner": "countersigner",
    "trusted-too": "identity CA, trusted too",
    "crl": "revocation list",
}
"""Kinds of `keystore.SharedStatus` in words."""
CERTIFICATE = "participant's certificate"
PERMISSIONS = "participant's permissions"


def of_set(words: str, set_name: str) -> str:
    """The words, and the further set of credentials that they are about, if it is one."""
    return f"{words}, set {set_name}" if set_name else words


_OVER = (State.REVOKED, State.GONE, State.ELSEWHERE)


def endings_of(status: Status, fleet: Fleet | None) -> tuple[Ending, ...]:
    """All that ends, the earliest first, of one kind and day together.

    Without a fleet, permissions are missing. Revoked and removed participants are left out.
    """
    found: dict[tuple[date, str], list[tuple[datetime, str]]] = defaultdict(list)
    for kind, at, name in _every(status, fleet):
        found[at.date(), kind].append((at, name))
    return tuple(
        Ending(kind=kind, at=min(each)[0], names=tuple(sorted(name for _, name in each)))
        for (_, kind), each in sorted(found.items())
    )


def _every(status: Status, fleet: Fleet | None) -> Iterator[tuple[str, datetime, str]]:
    for term in status.shared:
        if term.state is not State.GONE:
            kind = of_set(KINDS[term.kind], term.set_name)
            yield kind, term.not_after, term.name or kind
    for person in status.participants:
        for each in (person, *person.further) if person.state not in _OVER else ():
            yield of_set(CERTIFICATE, each.set_name), each.not_after, each.name
    for member in fleet.members if fleet else ():
        grants = member.permissions.grants_for(member.subject)
        yield PERMISSIONS, max(grant.not_after for grant in grants), member.name
