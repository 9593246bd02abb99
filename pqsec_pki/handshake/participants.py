"""The two sides of a handshake: our identity and policy, and the peer."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import field
from datetime import datetime
from itertools import chain
from typing import Self
from weakref import WeakValueDictionary

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KeyAgreement, PrivateKey, PublicKey
from pqsec_pki.certificates import (
    Certificate,
    RevocationList,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.errors import PqsecError, VerificationError, shown
from pqsec_pki.handshake.compact import FIRST_ONLY, WireVersion, check_carried
from pqsec_pki.handshake.conventions import OURS, MessageConventions
from pqsec_pki.handshake.guid import belongs_to, participant_data, participant_guid
from pqsec_pki.handshake.messages import CHALLENGE_SIZE, Introduction
from pqsec_pki.problems import Code, Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Our side: the credentials we send and the key we sign with."""

    certificate: Certificate
    key: PrivateKey = field(repr=False)
    """The certificate's private key, alone or paired with the alternative key."""
    ca: Certificate
    """The identity CA of both sides."""
    guid: bytes
    """16 bytes; see adjusted_guid."""
    permissions: bytes = field(repr=False)
    """The signed permissions document."""
    revocation_list: RevocationList | None = field(default=None, repr=False)
    """The identity CA's list, if any; it must be valid and not contain the peer's certificate."""

    def introduction(self, agreement: KeyAgreement, *, nul: bool) -> Introduction:
        """Our introduction; with `nul`, algorithm names end in NUL."""
        end = b"\0" if nul else b""
        return Introduction(
            certificate=self.certificate.pem,
            permissions=self.permissions,
            participant_data=participant_data(self.guid),
            signature_algorithm=self.key.algorithm.wire_name.encode() + end,
            key_agreement=agreement.wire_name.encode() + end,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerRequirements:
    """What we require of the peer, whatever it asks for."""

    agreements: tuple[KeyAgreement, ...]
    """Key agreements that a Request may ask for; any other counts as a downgrade."""
    versions: tuple[WireVersion, ...] = FIRST_ONLY
    """The versions of messages that a peer may send; we send the first, and answer in its own."""
    require_alternative: bool = False
    """Whether the peer needs an alternative key, and an alternative signature by its CA."""

    def versions_with(self, agreement: KeyAgreement) -> tuple[WireVersion, ...]:
        """The versions for a Request with `agreement`: that of 1.1 is for stock stacks too."""
        return self.versions if agreement.binds_transcript else FIRST_ONLY

    @property
    def readable(self) -> frozenset[WireVersion]:
        """The versions for Requests with any of the agreements."""
        return frozenset(chain.from_iterable(map(self.versions_with, self.agreements)))

    def agreement(self, name: str) -> KeyAgreement:
        """The key agreement with the c.kagree_algo `name`; VerificationError if not allowed."""
        for row in self.agreements:
            if row.wire_name == name:
                return row
        allowed = ", ".join(row.wire_name for row in self.agreements)
        words = f"the peer asks for {name!r}; allowed here: {allowed}"
        raise VerificationError(words, code=Code.C8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovered:
    """What discovery announced about the peer, not yet verified; None if not announced."""

    guid: bytes | None = None
    future_challenge: bytes | None = None
    """The future challenge in the peer's AuthRequest."""
    subject: bytes | None = None
    """The subject (DER Name) that it announced; see choice.py."""


NOTHING = Discovered()
_known: WeakValueDictionary[bytes, Certificate] = WeakValueDictionary()
"""Peers' certificates that are still in use, by their PEM."""


def peer_certificate(octets: bytes) -> Certificate:
    """The certificate in PEM `octets`: one object for all handshakes of a peer, parsed once.

    MalformedError if there is none. What depends on time or on a revocation list is not in it.
    """
    known = _known.get(octets)
    if known is not None:
        return known
    if found := Certificate.from_exact_pem(octets):
        return _known.setdefault(octets, found)
    found = Certificate.from_pem(octets)
    return _known.setdefault(found.pem, found)  # not by other `octets`, of which there are many


def _unreadable(code: Code, error: PqsecError) -> VerificationError:
    return VerificationError(f"the peer's introduction: {shown(str(error), 300)}", code=code)


@dataclass(frozen=True, slots=True, kw_only=True)
class RemotePeer:
    """The other side, as in its Introduction: decoded, not verified."""

    certificate: Certificate
    guid: bytes
    """16 bytes."""
    permissions: bytes = field(repr=False)
    """The signed permissions document; the handshake does not check its subject."""
    keys: tuple[PublicKey, ...] = field(repr=False)
    """The public keys of its certificate for handshake signatures, the strongest first."""

    @classmethod
    def read(cls, introduction: Introduction) -> Self:
        """The peer; VerificationError if certificate, keys or c.pdata cannot be decoded."""
        try:
            # OpenDDS adds a NUL to the file, also to the permissions.
            certificate = peer_certificate(introduction.certificate.rstrip(b"\0"))
            keys = certificate.handshake_keys
        except PqsecError as error:
            raise _unreadable(Code.C9, error) from error
        try:
            guid = participant_guid(introduction.participant_data)
        except PqsecError as error:
            raise _unreadable(Code.C11, error) from error
        permissions = introduction.permissions.rstrip(b"\0")
        return cls(certificate=certificate, guid=guid, permissions=permissions, keys=keys)

    def key_for(self, name: str, policy: PeerRequirements) -> PublicKey | None:
        """The peer's key with the c.dsign_algo `name`, if it has one and `policy` allows it."""
        keys = self.keys[:1] if policy.require_alternative else self.keys
        return next((key for key in keys if key.algorithm.wire_name == name), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """The parameters of our handshakes with one peer.

    MalformedError if the policy allows the second version of the messages, and that cannot carry
    our own certificate and permissions.
    """

    own: Identity
    policy: PeerRequirements
    discovered: Discovered = NOTHING
    announced: bytes | None = None
    """The future_challenge (32 bytes) in our own AuthRequest, if we sent one."""
    conventions: MessageConventions = OURS
    """How we write and read messages. Conventions of other implementations are for tests."""

    def __post_init__(self) -> None:
        if WireVersion.SECOND in self.policy.readable:
            check_carried(self.own.certificate.pem, self.own.permissions)

    def challenge(self) -> bytes:
        """Our challenge for one handshake: the announced one, or 32 new random bytes."""
        return self.announced or os.urandom(CHALLENGE_SIZE)

    def admit(
        self, introduction: Introduction, now: datetime, *, others: Iterable[Problem | str]
    ) -> tuple[RemotePeer, PublicKey]:
        """Verify the peer; returns it and the key that it must sign with.

        VerificationError lists everything that is wrong with it, and the problems in `others`.
        """
        peer = RemotePeer.read(introduction)
        name = introduction.signature_algorithm_name
        key = peer.key_for(name, self.policy)
        problems = [*self._problems(peer, now), *others]
        if key is None:
            # Not in the specification: Cyclone DDS does not compare it with the certificate.
            words = f"c.dsign_algo {name!r} does not match the certificate's key"
            problems.append(Problem(words, Code.C16))
        if problems or key is None:
            raise VerificationError(*problems)
        return peer, key

    def _problems(self, peer: RemotePeer, now: datetime) -> Iterator[Problem]:
        """In the order of DDS-Security 1.1, 9.3.3, table 52."""
        # c.id: issued by our identity CA, and in force
        required = self.policy.require_alternative
        try:
            verify_chain(peer.certificate, self.own.ca, now=now, require_alternative=required)
        except VerificationError as error:
            yield from error.problems
        yield from self._revocation_problems(peer, now)
        # c.pdata: the GUID is made from the certificate's subject name
        if not belongs_to(peer.guid, peer.certificate.subject_der):
            words = "the GUID in c.pdata does not belong to the certificate's subject"
            yield Problem(words, Code.C11)
        # Not in the specification: that subject must be the announced one.
        if self.discovered.subject not in (None, peer.certificate.subject_der):
            words = "the certificate's subject is not the one that was announced"
            yield Problem(words, Code.C29)
        # Not in the specification: it must also be the one that was discovered.
        if self.discovered.guid not in (None, peer.guid):
            words = "the GUID in c.pdata is not the one that was discovered"
            yield Problem(words, Code.C12)
        if peer.guid == self.own.guid:
            words = "the GUID in c.pdata is our own: the message was reflected"
            yield Problem(words, Code.C13)

    def _revocation_problems(self, peer: RemotePeer, now: datetime) -> Iterator[Problem]:
        if self.own.revocation_list is None:
            return
        required = self.policy.require_alternative
        try:
            verify_not_revoked(
                peer.certificate,
                self.own.revocation_list,
                self.own.ca,
                now=now,
                require_alternative=required,
            )
        except VerificationError as error:
            yield from error.problems
