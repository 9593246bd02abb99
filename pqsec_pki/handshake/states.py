"""The states of a handshake: one class for each state, one method for each step.

A state is a value. Its method takes the message it waits for and returns the next message
and state, so no step can be skipped or run out of order. Nothing here reads a file, a
socket or a clock.

    initiator                                     replier
    begin() -> Request, RequestSent
                                                  reply_to(request) -> Reply, ReplySent
    RequestSent.receive(reply) -> Final, Done
                                                  ReplySent.receive(final) -> Done

No message confirms the key: only the first protected message shows that both have the same.
"""

from collections.abc import Iterator
from dataclasses import field, replace
from datetime import datetime
from functools import lru_cache
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KeyAgreement, KeyPair, PublicKey
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake._checks import check
from pqsec_pki.handshake.compact import WireVersion, check_version
from pqsec_pki.handshake.messages import Final, Introduction, Reply, Request, Transcript
from pqsec_pki.handshake.participants import RemotePeer, Terms
from pqsec_pki.problems import Code, Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """The final state: the peer holds its certificate's key; both should have the same secret."""

    peer: RemotePeer
    agreement: KeyAgreement
    challenge1: bytes
    challenge2: bytes
    shared_secret: bytes = field(repr=False)
    """32 bytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestSent:
    """The initiator, waiting for a Reply."""

    terms: Terms
    request: Request
    hash_c1: bytes
    key_pair: KeyPair = field(repr=False)

    def receive(self, reply: Reply, *, now: datetime) -> tuple[Final, Done]:
        """The Final and the final state; VerificationError lists what is wrong with `reply`.

        Steps of DDS-Security 1.1, 9.3.3, table 52, process_handshake.
        """
        check_version(reply.version, (self.request.version,))
        transcript = self._transcript(reply)
        # c.id and c.pdata, then repeated values
        others = self._problems(reply, transcript)
        peer, key = self.terms.admit(reply.introduction, now, others=others)
        # the signature
        signed = transcript.reply_octets()
        _check_signature(Code.C21, key, reply.signature, signed)
        # dh2, then the secret
        with check(Code.C22):
            secret = self.key_pair.decapsulate(reply.dh2)
        signature = self.terms.own.key.sign_handshake(transcript.final_octets())
        final = self.terms.conventions.written(_final(transcript, signature, self.request.version))
        return final, _done(peer, self.key_pair.agreement, transcript, secret, signed)

    def _transcript(self, reply: Reply) -> Transcript:
        return Transcript(
            hash_c1=self.hash_c1,
            hash_c2=reply.introduction.digest(),
            challenge1=self.request.challenge1,
            challenge2=reply.challenge2,
            dh1=self.request.dh1,
            dh2=reply.dh2,
        )

    def _problems(self, reply: Reply, transcript: Transcript) -> Iterator[Problem | str]:
        yield from self.terms.conventions.problems(reply)
        # Not in the specification: Cyclone DDS lets the replier choose another one.
        if reply.introduction.key_agreement_name != self.key_pair.agreement.wire_name:
            yield Problem("c.kagree_algo is not what was asked for", Code.C18)
        # challenge1 is required; hash_c1, hash_c2 and dh1 must be correct if present
        yield from transcript.differences(reply)
        # challenge2 is the announced one
        if self.terms.discovered.future_challenge not in (None, reply.challenge2):
            yield Problem("challenge2 is not the one that the peer announced", Code.C20)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplySent:
    """The replier, waiting for a Final."""

    transcript: Transcript
    version: WireVersion = WireVersion.FIRST
    """The version of the messages."""
    peer_key: PublicKey = field(repr=False)
    """The public key for the signature of the Final."""
    _outcome: Done = field(repr=False)
    """The final state, once the signature was verified."""

    @property
    def peer(self) -> RemotePeer:
        """The peer that must send it: its certificate is valid, but its key is not yet proved."""
        return self._outcome.peer

    def sharing(self, permissions: bytes) -> Self:
        """This state with `permissions` as the object for the peer's permissions document.

        It must equal the peer's, so that many states share one copy; ValueError if not.
        """
        if permissions != self.peer.permissions:
            raise ValueError("the document to share is not the peer's")
        peer = replace(self.peer, permissions=permissions)
        return replace(self, _outcome=replace(self._outcome, peer=peer))

    def receive(self, final: Final) -> Done:
        """The final state; VerificationError lists what is wrong with `final`.

        Steps of DDS-Security 1.1, 9.3.3, table 52, process_handshake.
        """
        check_version(final.version, (self.version,))
        # in the first version the challenges are required; other repeated values must be correct
        if problems := self.transcript.differences(final):
            raise VerificationError(*problems)
        # the signature
        signed = self.transcript.final_octets()
        _check_signature(Code.C24, self.peer_key, final.signature, signed)
        return self._outcome


_own_digest = lru_cache(maxsize=16)(Introduction.digest)
"""A cache: our introduction is the same for every peer."""


def begin(terms: Terms, agreement: KeyAgreement) -> tuple[Request, RequestSent]:
    """The Request, and the state that waits for its Reply."""
    # Cyclone DDS and OpenDDS end names in NUL, and OpenDDS requires it; all accept it.
    version = terms.policy.versions_with(agreement)[0]
    introduction = _introduced(terms, agreement, version, nul=terms.conventions.ends_names_in_nul)
    hash_c1 = _own_digest(introduction)
    pair = agreement.generate()
    request = Request(
        introduction=introduction,
        hash_c1=hash_c1,
        dh1=pair.public,
        challenge1=terms.challenge(),
    )
    waiting = RequestSent(terms=terms, request=request, hash_c1=hash_c1, key_pair=pair)
    return terms.conventions.written(request), waiting


def reply_to(terms: Terms, request: Request, *, now: datetime) -> tuple[Reply, ReplySent]:
    """The Reply, and the state that waits for its Final.

    VerificationError lists what is wrong with `request`. Steps of DDS-Security 1.1,
    9.3.3, table 52, begin_handshake_reply.
    """
    # Not in the specification: c.kagree_algo must be one that the policy allows.
    agreement = terms.policy.agreement(request.introduction.key_agreement_name)
    check_version(request.version, terms.policy.versions_with(agreement))
    # c.id and c.pdata, then repeated values
    hash_c1 = request.introduction.digest()
    others = _request_problems(request, hash_c1, terms)
    peer, key = terms.admit(request.introduction, now, others=others)
    # dh1, then the secret
    with check(Code.C17):
        dh2, secret = agreement.encapsulate(request.dh1)
    # Fast DDS refuses names with NUL as initiator, OpenDDS refuses them without.
    nul = terms.conventions.answers_with_nul(request)
    introduction = _introduced(terms, agreement, request.version, nul=nul)
    transcript = Transcript(
        hash_c1=hash_c1,
        hash_c2=_own_digest(introduction),
        challenge1=request.challenge1,
        challenge2=terms.challenge(),
        dh1=request.dh1,
        dh2=dh2,
    )
    signed = transcript.reply_octets()
    signature = terms.own.key.sign_handshake(signed)
    reply = Reply(introduction=introduction, signature=signature, **transcript.values())
    reply = terms.conventions.written(reply)
    outcome = _done(peer, agreement, transcript, secret, signed)
    return reply, ReplySent(
        transcript=transcript, version=request.version, peer_key=key, _outcome=outcome
    )


def _introduced(
    terms: Terms, agreement: KeyAgreement, version: WireVersion, *, nul: bool
) -> Introduction:
    """Our introduction in that version."""
    introduction = terms.own.introduction(agreement, nul=nul)
    return introduction if version is WireVersion.FIRST else introduction.in_second_version()


def _final(transcript: Transcript, signature: bytes, version: WireVersion) -> Final:
    if version is WireVersion.FIRST:
        return Final(signature=signature, **transcript.values())
    return Final(challenge1=None, challenge2=None, signature=signature)


def _request_problems(request: Request, hash_c1: bytes, terms: Terms) -> Iterator[Problem | str]:
    yield from terms.conventions.problems(request)
    # challenge1 is the announced one
    if terms.discovered.future_challenge not in (None, request.challenge1):
        yield Problem("challenge1 is not the one that the peer announced", Code.C14)
    # hash_c1, if sent; Fast DDS only warns
    if request.hash_c1 not in (None, hash_c1):
        yield Problem("hash_c1 is not as expected", Code.C15)


def _check_signature(code: Code, key: PublicKey, signature: bytes, signed: bytes) -> None:
    with check(code):
        key.verify_handshake(signature, signed)


def _done(
    peer: RemotePeer, agreement: KeyAgreement, transcript: Transcript, secret: bytes, signed: bytes
) -> Done:
    return Done(
        peer=peer,
        agreement=agreement,
        challenge1=transcript.challenge1,
        challenge2=transcript.challenge2,
        shared_secret=agreement.shared_secret(secret, signed),
    )
