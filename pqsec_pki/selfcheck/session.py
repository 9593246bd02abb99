"""The two sides of a handshake, and the network between them."""

from collections.abc import Callable
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KeyAgreement, Profile
from pqsec_pki.credentials import Credentials
from pqsec_pki.handshake import Terms, WireVersion
from pqsec_pki.selfcheck.stacks import SimulatedStack

_STATELESS_WRITER = bytes.fromhex("000201c3")
"""The entity ID of the writer of handshake messages (DDS-Security 1.1, 7.4.6.2)."""

Relay = Callable[[str, bytes], bytes]
"""Takes the name and the sample of a message, and returns the sample that arrives."""


def unchanged(name: str, sample: bytes) -> bytes:
    """The relay of an honest network."""
    del name
    return sample


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSide:
    """A participant, the stack it behaves like, and what it requires of its peer."""

    participant: Credentials
    stack: SimulatedStack
    terms: Terms

    @property
    def name(self) -> str:
        """The name of its enclave."""
        return self.participant.name

    @property
    def guid(self) -> bytes:
        """16 bytes."""
        return self.terms.own.guid

    @property
    def writer(self) -> bytes:
        """The GUID (16 bytes) of the writer of its handshake messages."""
        return self.guid[:12] + _STATELESS_WRITER


@dataclass(frozen=True, slots=True, kw_only=True)
class HandshakeSession:
    """The two sides of a handshake, its domain and time, and the network between them."""

    initiator: SessionSide
    replier: SessionSide
    agreement: KeyAgreement
    """The key agreement that the initiator asks for."""
    profile: Profile
    domain: int
    now: datetime
    relay: Relay = unchanged
    third: SessionSide | None = None
    """The peer that both sides have discovered, if it is not the other side."""

    @property
    def sides(self) -> tuple[SessionSide, SessionSide]:
        """The initiator and the replier."""
        return self.initiator, self.replier

    @property
    def version(self) -> WireVersion:
        """The version of the Request that the initiator sends."""
        return self.initiator.terms.policy.versions_with(self.agreement)[0]

    def peer_of(self, side: SessionSide) -> bytes:
        """The GUID (16 bytes) of the peer that `side` has discovered."""
        if self.third:
            return self.third.guid
        return self.replier.guid if side is self.initiator else self.initiator.guid
