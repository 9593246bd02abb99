"""An attack: one row of the table, and the row acts."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from pqsec_pki.attacks._context import AttackContext, Attempt
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck.session import HandshakeSession


class Attacker(StrEnum):
    """Who attacks, by what it has."""

    ON_THE_WAY = "on the way"
    """Reads and changes whatever is sent; has no key."""
    OUTSIDER = "outsider"
    """Has what was ever sent, and keys and certificates of its own making."""
    QUANTUM = "quantum computer"
    """An outsider who has found the classical keys, but not the post-quantum ones."""
    INSIDER = "insider"
    """Is a participant of the domain."""


CERTIFICATE = (
    *(Code.WRONG_ISSUER, Code.BAD_SIGNATURE, Code.ALTERNATIVE_MISSING, Code.ALTERNATIVE_BAD),
    *(Code.EXPIRED, Code.NOT_YET_VALID, Code.CRITICAL_EXTENSION, Code.NOT_PARTICIPANT),
    *(Code.KEY_USAGE, Code.REVOKED),
)
"""C10 of docs/wire.md: what can be wrong with a participant's certificate."""
DOCUMENT = (
    *(Code.NOT_SIGNED, Code.WRONG_SIGNER, Code.CONTENT_CHANGED, Code.SIGNATURE_BAD),
    *(Code.SIGNATURE_MISSING, Code.COUNTERSIGNATURE_BAD, Code.DOCUMENT_INVALID),
    *(Code.NO_GRANT, Code.GRANT_EXPIRED, Code.NO_DOMAIN_RULE, Code.DOMAIN_DENIED, Code.C25),
)
"""C25: what can be wrong with permissions."""
TRANSCRIPT = (Code.C19, Code.C21, Code.C23, Code.C24, Code.C26)
"""Repetitions, signatures and key: they cover whatever is said in a handshake."""
COVERED = "what is changed is repeated, is in both signatures and, with a bound secret, in the key"


def _anywhere(session: HandshakeSession) -> str | None:
    del session
    return None


def two_keys(session: HandshakeSession) -> str | None:
    if session.profile.alternative_key:
        return None
    return f"participants of profile {session.profile.name} have one key"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """One way to attack two who would meet."""

    name: str
    """What a user types."""
    attacker: Attacker
    title: str
    """What the attacker does, in words for who is no expert."""
    refused_at: tuple[str, ...]
    """Where it has to fail: a word of the name of the step."""
    checks: tuple[Code, ...]
    """What has to refuse it: a refusal for any other reason is none."""
    also: tuple[Code, ...] = ()
    """What would refuse some of its attempts all the same, were those checks missing."""
    because: str = ""
    """Why that is so."""
    act: Callable[[AttackContext], Iterator[Attempt]] = field(repr=False)
    not_applicable: Callable[[HandshakeSession], str | None] = field(default=_anywhere, repr=False)
    """Why it is none for those two, if it is none."""
