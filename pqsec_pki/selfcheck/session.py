"""The two sides of a handshake, and the network between them."""

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KeyAgreement, Profile
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import Credentials
from pqsec_pki.handshake import PolicyRow, Terms, WireVersion, refuse_weak_set, set_of
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
    sets: "SideSets | None" = None
    """Its sets of credentials, if it has several; `terms` are those of one of them."""

    @property
    def name(self) -> str:
        """The name of its enclave."""
        return self.participant.name

    @property
    def guid(self) -> bytes:
        """16 bytes."""
        return self.terms.own.guid

    @property
    def peer_subject(self) -> bytes | None:
        """The subject (DER Name) that its peer announced, if that chose the row of its policy."""
        return self.sets.row.subject if self.sets else None

    def with_guid(self, guid: bytes) -> "SessionSide":
        """The same participant with that GUID."""
        return replace(self, terms=replace(self.terms, own=replace(self.terms.own, guid=guid)))

    def answering(self, certificate: Certificate) -> "SessionSide":
        """The side in the set with which it answers a peer that shows `certificate`.

        VerificationError (C30) if its policy does not allow that set for the peer.
        """
        found = self.sets.of(certificate) if self.sets else self
        same = found.participant is self.participant
        return self if same else replace(found, sets=self.sets)

    @property
    def writer(self) -> bytes:
        """The GUID (16 bytes) of the writer of its handshake messages."""
        return self.guid[:12] + _STATELESS_WRITER


@dataclass(frozen=True, slots=True, kw_only=True)
class SideSets:
    """The sets of a participant that has several, and its policy about the peer."""

    profiles: tuple[str, ...]
    sides: tuple[SessionSide, ...]
    """The participant in each set, that of stock stacks first."""
    row: PolicyRow

    def of(self, certificate: Certificate) -> SessionSide:
        """The side in the set of that certificate; VerificationError (C30) if not allowed."""
        number = set_of(certificate, [(each.terms.own.ca,) for each in self.sides])
        refuse_weak_set(self.row, number, self.profiles)
        return self.sides[number]


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
