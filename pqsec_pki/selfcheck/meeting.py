"""Two participants of a keystore meet, in memory, as two DDS processes would.

Every message passes as bytes, encoded and decoded as on the wire. The handshake alone
does not prove that both hold the same secret, so it goes on to one protected message
each way.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime

from pqsec_pki.algorithms import KeyAgreement, Profile, pair_private
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.handshake import (
    DataHolder,
    Discovered,
    Done,
    Final,
    Identity,
    Policy,
    Reply,
    Request,
    Terms,
    adjusted_guid,
    begin,
    initiates,
    key_exchange_material,
    protect,
    reply_to,
    unprotect,
)
from pqsec_pki.keystore import Keystore, Participant
from pqsec_pki.selfcheck.credentials import (
    Applicant,
    check_documents,
    check_identity,
    check_permissions,
)
from pqsec_pki.selfcheck.report import Report, Step

_ENTITY_ID = bytes.fromhex("000001c1")
"""ENTITYID_PARTICIPANT (RTPS 2.3, table 9.1)."""
_SUBMESSAGE = bytes.fromhex("15010c00") + b"pqsec check."
"""A DATA submessage of 12 bytes: something to protect."""


class _Stopped(Exception):  # noqa: N818 -- not an error: the report has it
    """A step failed; the report says which."""


@dataclass(slots=True)
class _Steps:
    done: list[Step] = field(default_factory=list)

    @contextmanager
    def step(self, name: str) -> Iterator[list[str]]:
        """Run one step; what is put in the list is its detail."""
        detail: list[str] = []
        try:
            yield detail
        except PqsecError as error:
            self.done.append(Step(name, ok=False, detail=str(error), hint=error.hint))
            raise _Stopped from error
        self.done.append(Step(name, ok=True, detail="; ".join(detail)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Side:
    participant: Participant
    terms: Terms

    @property
    def name(self) -> str:
        return self.participant.name

    @property
    def guid(self) -> bytes:
        return self.terms.own.guid


def meet(  # noqa: PLR0913 -- each is a choice of the user's
    keystore: Keystore,
    first: str,
    second: str,
    *,
    agreement: KeyAgreement,
    domain: int,
    now: datetime,
) -> Report:
    """The handshake between participants `first` and `second`, and what it showed.

    A step that fails ends it, and is the last in the report. KeystoreError if a
    participant is not there at all.
    """
    for name in (first, second):
        keystore.refuse_unknown(name)
    meeting = _Meeting(keystore, agreement, domain, now)
    with suppress(_Stopped):
        meeting.run(first, second)
    return meeting.report()


@dataclass(slots=True)
class _Meeting:
    keystore: Keystore
    agreement: KeyAgreement
    domain: int
    now: datetime
    steps: _Steps = field(default_factory=_Steps)
    sides: tuple[_Side, _Side] | None = None
    sizes: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0

    def run(self, first: str, second: str) -> None:
        initiator, replier = self._cast(self._load(first), self._load(second))
        started = time.perf_counter()
        done_initiator, done_replier = self._shake_hands(initiator, replier)
        self._exchange(initiator, done_initiator, replier, done_replier)
        self.seconds = time.perf_counter() - started
        self._check_peer(initiator, replier.participant, done_initiator)
        self._check_peer(replier, initiator.participant, done_replier)

    def report(self) -> Report:
        initiator, replier = self.sides or (None, None)
        return Report(
            steps=tuple(self.steps.done),
            initiator=initiator.name if initiator else None,
            replier=replier.name if replier else None,
            why=_why(initiator, replier) if initiator and replier else None,
            signature=_signatures(initiator, replier) if initiator and replier else None,
            key_agreement=self.agreement.wire_name,
            token_bytes=self.sizes,
            milliseconds=round(self.seconds * 1000, 3),
        )

    @property
    def _profile(self) -> Profile:
        return self.keystore.profile

    def _load(self, name: str) -> Participant:
        """The participant, if it can be read and its own credentials are sound."""
        name = "/" + "/".join(part for part in name.split("/") if part)
        with self.steps.step(f"files of {name}") as detail:
            try:
                participant = self.keystore.participant(name)
            except PqsecError as error:
                error.hint = error.hint or f"issue it again: pqsec issue {name} --force"
                raise
            detail.append("keys, certificates, permissions and governance read")
        with self.steps.step(f"identity of {participant.name}") as detail:
            detail.append(check_identity(participant, self._profile, self.now))
        with self.steps.step(f"documents of {participant.name}") as detail:
            detail.append(check_documents(participant, self._profile, self.domain, self.now))
        return participant

    def _cast(self, first: Participant, second: Participant) -> tuple[_Side, _Side]:
        """(initiator, replier); the smaller GUID speaks first."""
        sides = [self._side(each) for each in (first, second)]
        with self.steps.step("who speaks first") as detail:
            one, other = sides
            if one.name == other.name:
                raise VerificationError(
                    f"both are {one.name}: a participant cannot meet itself",
                    hint="name two different participants",
                )
            self.sides = (one, other) if initiates(one.guid, other.guid) else (other, one)
            detail.append(_why(*self.sides))
        return self.sides

    def _side(self, participant: Participant) -> _Side:
        second = participant.alternative_key
        candidate = os.urandom(12) + _ENTITY_ID
        identity = Identity(
            certificate=participant.certificate,
            key=pair_private(participant.key, second) if second else participant.key,
            ca=participant.identity_ca,
            guid=adjusted_guid(participant.certificate.subject_der, candidate),
            permissions=participant.permissions,
        )
        policy = Policy(
            agreements=(self.agreement,),
            require_alternative=self._profile.alternative_key is not None,
        )
        return _Side(participant=participant, terms=Terms(own=identity, policy=policy))

    def _shake_hands(self, initiator: _Side, replier: _Side) -> tuple[Done, Done]:
        ours = _meeting_terms(initiator, replier)
        theirs = _meeting_terms(replier, initiator)
        with self.steps.step("request") as detail:
            request, waiting = begin(ours, self.agreement)
            heard = Request.from_holder(self._carry("request", request.to_holder(), detail))
        with self.steps.step("reply") as detail:
            reply, awaiting = reply_to(theirs, heard, now=self.now)
            answer = Reply.from_holder(self._carry("reply", reply.to_holder(), detail))
        with self.steps.step("final") as detail:
            final, done = waiting.receive(answer, now=self.now)
            last = Final.from_holder(self._carry("final", final.to_holder(), detail))
        with self.steps.step("authenticated") as detail:
            outcome = awaiting.receive(last)
            detail.append(f"{initiator.name} and {replier.name} each proved their key")
        return done, outcome

    def _carry(self, name: str, holder: DataHolder, detail: list[str]) -> DataHolder:
        """The message as the other side reads it off the wire."""
        data = holder.encode()
        self.sizes[name] = len(data)
        detail.append(f"{len(data)} bytes")
        return DataHolder.decode(data)

    def _exchange(self, one: _Side, one_done: Done, other: _Side, other_done: Done) -> None:
        for sender, mine, receiver, theirs in (
            (one, one_done, other, other_done),
            (other, other_done, one, one_done),
        ):
            with self.steps.step(f"message {sender.name} to {receiver.name}") as detail:
                sealed = protect(key_exchange_material(mine), _SUBMESSAGE)
                if unprotect(key_exchange_material(theirs), sealed) != _SUBMESSAGE:
                    raise VerificationError("the message came out changed")
                detail.append("encrypted, sent, decrypted (AES256-GCM)")

    def _check_peer(self, judge: _Side, subject: Participant, done: Done) -> None:
        """The permissions that came in the handshake are the subject's own, and let it in."""
        with self.steps.step(f"{judge.name} admits {subject.name}") as detail:
            if done.peer.permissions != subject.permissions:
                raise VerificationError("other permissions arrived than were sent")
            # What came with the handshake, not what lies on our disk.
            applicant = Applicant(subject.name, done.peer.certificate, done.peer.permissions)
            own = judge.participant
            detail.append(check_permissions(own, applicant, self._profile, self.domain, self.now))


def _meeting_terms(own: _Side, peer: _Side) -> Terms:
    """Our terms, now that discovery has shown us the peer's GUID."""
    terms = own.terms
    return Terms(own=terms.own, policy=terms.policy, discovered=Discovered(guid=peer.guid))


def _why(initiator: _Side, replier: _Side) -> str:
    mine, theirs = initiator.guid[:6].hex(), replier.guid[:6].hex()
    return (
        f"{initiator.name} initiates: its GUID is smaller ({mine} < {theirs});"
        " these bits come from the subject name, so it is so every time"
    )


def _signatures(initiator: _Side, replier: _Side) -> str:
    names = [side.terms.own.key.algorithm.wire_name for side in (initiator, replier)]
    return names[0] if names[0] == names[1] else ", ".join(names)
