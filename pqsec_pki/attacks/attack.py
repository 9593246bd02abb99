"""An attack: one row of the table, with the function that carries it out."""

from collections.abc import Callable, Iterator
from dataclasses import field
from enum import StrEnum

from pqsec_pki._dataclass import dataclass
from pqsec_pki.attacks._context import AttackContext, Attempt
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HandshakeSession


class Attacker(StrEnum):
    """Kinds of attackers, by what they have."""

    ON_THE_WAY = "on the way"
    """Reads and changes all messages; has no key."""
    OUTSIDER = "outsider"
    """Has all messages ever sent, and keys and certificates that it created."""
    QUANTUM = "quantum computer"
    """An outsider that has computed the classical private keys, but not the post-quantum ones."""
    INSIDER = "insider"
    """Is a participant of the domain."""


CERTIFICATE = (
    *(Code.WRONG_ISSUER, Code.BAD_SIGNATURE, Code.ALTERNATIVE_MISSING, Code.ALTERNATIVE_BAD),
    *(Code.EXPIRED, Code.NOT_YET_VALID, Code.CRITICAL_EXTENSION, Code.NOT_PARTICIPANT),
    *(Code.KEY_USAGE, Code.REVOKED),
)
"""C10 of docs/reference/wire.md: what can be wrong with a participant's certificate."""
DOCUMENT = (
    *(Code.NOT_SIGNED, Code.WRONG_SIGNER, Code.CONTENT_CHANGED, Code.SIGNATURE_BAD),
    *(Code.SIGNATURE_MISSING, Code.COUNTERSIGNATURE_BAD, Code.DOCUMENT_INVALID),
    *(Code.NO_GRANT, Code.GRANT_EXPIRED, Code.NO_DOMAIN_RULE, Code.DOMAIN_DENIED, Code.C25),
)
"""C25: what can be wrong with permissions."""
TRANSCRIPT = (Code.C19, Code.C21, Code.C23, Code.C24, Code.C26)
"""Repeated values, signatures and keys: they cover all values of a handshake."""
COVERED = "a changed value is repeated, in both signatures and, with a bound secret, in the key"


def _always_applicable(session: HandshakeSession) -> str | None:
    del session
    return None


def two_keys(session: HandshakeSession) -> str | None:
    if session.profile.alternative_key:
        return None
    return f"participants of profile {session.profile.name} have one key"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """One way to attack a handshake."""

    name: str
    """Its name on the command line."""
    attacker: Attacker
    title: str
    """What the attacker does, in words for non-experts."""
    refused_at: tuple[str, ...]
    """The steps at which it has to fail: a word of the name of the step."""
    checks: tuple[Code, ...]
    """The checks that have to refuse it: a refusal for any other reason does not count."""
    also: tuple[Code, ...] = ()
    """Checks that would still refuse some of its attempts if `checks` were missing."""
    because: str = ""
    """The reason for `also`."""
    act: Callable[[AttackContext], Iterator[Attempt]] = field(repr=False)
    not_applicable: Callable[[HandshakeSession], str | None] = field(
        default=_always_applicable, repr=False
    )
    """Returns why the attack does not apply to a session; None if it does."""
