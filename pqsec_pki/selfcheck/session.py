"""Who meets whom, and over what kind of network."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

from pqsec_pki.algorithms import KeyAgreement, Profile
from pqsec_pki.credentials import Credentials
from pqsec_pki.handshake import Terms
from pqsec_pki.selfcheck.stacks import Stack

_STATELESS_WRITER = bytes.fromhex("000201c3")
"""The entity that sends handshake messages (DDS-Security 1.1, 7.4.6.2)."""

Relay = Callable[[str, bytes], bytes]
"""What arrives when the sample of the message of that name is sent."""


def unchanged(name: str, sample: bytes) -> bytes:
    """What an honest network does."""
    del name
    return sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """A participant, how it behaves, and what it insists on."""

    participant: Credentials
    stack: Stack
    terms: Terms

    @property
    def name(self) -> str:
        """Its enclave."""
        return self.participant.name

    @property
    def guid(self) -> bytes:
        """16 bytes."""
        return self.terms.own.guid

    @property
    def writer(self) -> bytes:
        """The GUID (16 bytes) of what sends its handshake messages."""
        return self.guid[:12] + _STATELESS_WRITER


@dataclass(frozen=True, slots=True, kw_only=True)
class HandshakeSession:
    """Who meets whom, where and when, and over what kind of network."""

    initiator: Side
    replier: Side
    agreement: KeyAgreement
    """What the initiator asks for."""
    profile: Profile
    domain: int
    now: datetime
    relay: Relay = unchanged
    third: Side | None = None
    """Whom each of the two has discovered as its peer, where that is not the other."""

    @property
    def sides(self) -> tuple[Side, Side]:
        """The initiator and the replier."""
        return self.initiator, self.replier

    def peer_of(self, side: Side) -> bytes:
        """The GUID (16 bytes) that `side` has discovered as its peer's."""
        if self.third:
            return self.third.guid
        return self.replier.guid if side is self.initiator else self.initiator.guid
