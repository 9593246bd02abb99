"""One run of a session: the messages from the first challenge to the first protected one.

Every message passes through a relay as bytes, encoded and decoded as on the wire. The relay
of an honest network changes nothing; an attacker's relay may.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import field, replace

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError, VerificationError, shown
from pqsec_pki.handshake import (
    CHALLENGE_SIZE,
    AuthRequest,
    DataHolder,
    Discovered,
    Done,
    Final,
    GenericMessage,
    KeyMaterial,
    MessageClass,
    RemotePeer,
    Reply,
    Request,
    Terms,
    TransformationKind,
    begin,
    check,
    confirmation,
    confirmed,
    reply_to,
)
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck.credentials import Applicant, check_permissions
from pqsec_pki.selfcheck.report import AUTH_REQUEST, HANDSHAKE, MESSAGE, Sent, Steps
from pqsec_pki.selfcheck.session import HandshakeSession, SessionSide

_CLASSES = {AUTH_REQUEST: MessageClass.AUTH_REQUEST} | dict.fromkeys(
    HANDSHAKE, MessageClass.HANDSHAKE
)
_ANSWERS = {"reply", "final"}
AROUND_TOKEN = 124
"""Bytes of the sample of a handshake message before its token."""


@dataclass(slots=True)
class HandshakeRun:
    """One run of a session: what was sent so far, and its result."""

    session: HandshakeSession
    steps: Steps
    sent: list[Sent] = field(default_factory=list)
    done: tuple[Done, Done] | None = None
    """The results of initiator and replier."""
    seconds: float = 0.0
    """Time of the messages and the key exchange, without the checks of permissions."""

    def perform(self) -> None:
        """Run all steps in order. StoppedError if one fails; `steps` has the reason."""
        started = time.perf_counter()
        self.done = self._shake_hands(*self._announce())
        self._exchange(self.done)
        self.seconds = time.perf_counter() - started
        one, other = self.session.sides
        self._admit(one, other, self.done[0])
        self._admit(other, one, self.done[1])

    def _announce(self) -> tuple[Terms, Terms]:
        """The terms of both, after each received the other's AuthRequest, if one is sent."""
        one, other = self.session.sides
        with self.steps.step("auth requests") as detail:
            mine, heard_by_other = self._auth_request(one, other)
            theirs, heard_by_one = self._auth_request(other, one)
            names = [side.name for side in (one, other) if side.stack.announces]
            detail.append(f"challenges announced by {' and '.join(names) or 'neither participant'}")
        return (
            self._terms(one, mine, heard_by_one),
            self._terms(other, theirs, heard_by_other),
        )

    def _terms(self, own: SessionSide, announced: bytes | None, received: bytes | None) -> Terms:
        """The terms of `own`, with what discovery showed about the peer."""
        discovered = Discovered(
            guid=self.session.peer_of(own), future_challenge=received, subject=own.peer_subject
        )
        return replace(own.terms, discovered=discovered, announced=announced)

    def _answering(self, replier: SessionSide, terms: Terms, request: Request) -> Terms:
        """The terms of the set with which the replier answers; its side is then that of the set."""
        if replier.sets is None:
            return terms
        side = replier.answering(RemotePeer.read(request.introduction).certificate)
        self.session = replace(self.session, replier=side)
        return replace(side.terms, discovered=terms.discovered, announced=terms.announced)

    def _auth_request(
        self, sender: SessionSide, receiver: SessionSide
    ) -> tuple[bytes | None, bytes | None]:
        """The announced challenge, as sent and as received."""
        if not sender.stack.announces:
            return None, None
        challenge = os.urandom(CHALLENGE_SIZE)
        token = AuthRequest(future_challenge=challenge).to_holder()
        arrived = self._send(AUTH_REQUEST, token, sender, receiver)
        heard = AuthRequest.from_holder(_opened(AUTH_REQUEST, arrived, receiver))
        return challenge, heard.future_challenge

    def _shake_hands(self, ours: Terms, theirs: Terms) -> tuple[Done, Done]:
        """In each step one side reads a message and sends the next."""
        (initiator, replier), now = self.session.sides, self.session.now
        with self._step("request", initiator) as detail:
            request, waiting = begin(ours, self.session.agreement)
            arrived = self._send("request", request.to_holder(), initiator, replier)
            detail.extend(self._size(initiator))
        with self._step("reply", replier) as detail:
            heard = Request.from_holder(_opened("request", arrived, replier))
            theirs = self._answering(replier, theirs, heard)
            reply, awaiting = reply_to(theirs, heard, now=now)
            arrived = self._send("reply", reply.to_holder(), replier, initiator)
            detail.extend(self._size(replier))
        with self._step("final", initiator) as detail:
            answer = Reply.from_holder(_opened("reply", arrived, initiator))
            final, done = waiting.receive(answer, now=now)
            arrived = self._send("final", final.to_holder(), initiator, replier)
            detail.extend(self._size(initiator))
        with self._step("authenticated", replier) as detail:
            last = Final.from_holder(_opened("final", arrived, replier))
            outcome = awaiting.receive(last)
            detail.append(
                f"{initiator.name} and {replier.name} each proved possession of their key"
            )
        return done, outcome

    @contextmanager
    def _step(self, name: str, side: SessionSide) -> Iterator[list[str]]:
        """A step of `side`; if `side` is a stock stack, the error names the stack."""
        with self.steps.step(name) as detail:
            try:
                yield detail
            except PqsecError as error:
                if not side.stack.is_stock:
                    raise
                hint = error.hint or self.session.initiator.stack.hint_as_initiator
                words = f"{side.stack.title} ({side.name}) refuses: {error}"
                raise VerificationError(words, hint=hint) from error

    def _send(
        self, name: str, token: DataHolder, sender: SessionSide, receiver: SessionSide
    ) -> bytes:
        """The sample that `receiver` gets when `sender` sends the token."""
        # A reply names the message that it answers: otherwise Fast DDS drops it.
        related = (receiver.writer, len(self.sent)) if name in _ANSWERS else (bytes(16), 0)
        message = GenericMessage(
            source=sender.writer,
            sequence=1 + len(self.sent),
            related_source=related[0],
            related_sequence=related[1],
            destination_participant=self.session.peer_of(sender),
            class_id=_CLASSES[name],
            tokens=(token,),
        )
        return self._relay(name, message.encode(), sender, receiver)

    def _size(self, sender: SessionSide) -> Iterator[str]:
        """The size of the last message, with a note if some versions cannot send it."""
        size = len(self.sent[-1].data)
        yield f"{size - AROUND_TOKEN} bytes"
        yield from sender.stack.check_size(size)

    def _relay(self, name: str, data: bytes, sender: SessionSide, receiver: SessionSide) -> bytes:
        sent = Sent(name=name, sender=sender.name, receiver=receiver.name, data=data)
        self.sent.append(sent)
        return self.session.relay(name, data)

    def _exchange(self, done: tuple[Done, Done]) -> None:
        """Send a protected message each way, to show that both have the same secret (C26)."""
        for sender, mine, receiver, theirs in _both_ways(self.session.sides, done):
            with self.steps.step(f"message {sender.name} to {receiver.name}") as detail:
                keys = KeyMaterial.generate(TransformationKind.AES256_GCM)
                sealed = confirmation(sender.guid, mine, keys)
                arrived = self._relay(MESSAGE, sealed, sender, receiver)
                confirmed(receiver.guid, theirs, arrived)
                detail.append("encrypted, sent, decrypted (AES256-GCM)")

    def _admit(self, judge: SessionSide, subject: SessionSide, done: Done) -> None:
        """Check that the permissions from the handshake are the subject's and let it join."""
        session = self.session
        with self.steps.step(f"{judge.name} admits {subject.name}") as detail:
            # The permissions that came with the handshake, not those on disk.
            peer = done.peer
            applicant = Applicant(subject.name, peer.certificate, peer.permissions)
            own = judge.participant
            with check(Code.C25):
                domain, now = session.domain, session.now
                detail.append(check_permissions(own, applicant, domain, now, judge.stack))


def _opened(name: str, sample: bytes, reader: SessionSide) -> DataHolder:
    """The token in a sample, as `reader` decodes it."""
    with check(Code.C1):
        message = GenericMessage.decode(sample)
    with check(Code.C2):
        _check_envelope(message, _CLASSES[name], reader)
    return message.tokens[0]


def _check_envelope(message: GenericMessage, wanted: MessageClass, reader: SessionSide) -> None:
    if message.class_id != wanted:
        raise VerificationError(f"expected a '{wanted}', got a '{shown(message.class_id)}'")
    if message.destination_participant != reader.guid:
        raise VerificationError("a message for another participant")
    if len(message.tokens) != 1:
        raise VerificationError(f"expected one token, got {len(message.tokens)}")


def _both_ways(
    sides: tuple[SessionSide, SessionSide], done: tuple[Done, Done]
) -> Iterator[tuple[SessionSide, Done, SessionSide, Done]]:
    (one, other), (mine, theirs) = sides, done
    yield one, mine, other, theirs
    yield other, theirs, one, mine
