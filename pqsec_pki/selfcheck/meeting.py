"""Two participants of a keystore meet, in memory, as two DDS processes would."""

import os
import shlex
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import NamedTuple

from pqsec_pki.algorithms import KeyAgreement, Profile, pair_private
from pqsec_pki.credentials import Credentials
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.handshake import Identity, Terms, adjusted_guid, initiates
from pqsec_pki.keystore import Keystore, regular_name
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck.course import Course
from pqsec_pki.selfcheck.credentials import check_documents, check_identity, renewal
from pqsec_pki.selfcheck.encounter import Encounter, Side
from pqsec_pki.selfcheck.report import Report, Steps, StoppedError
from pqsec_pki.selfcheck.stacks import PQSEC, Stack, asked, policy

_ENTITY_ID = bytes.fromhex("000001c1")
"""ENTITYID_PARTICIPANT (RTPS 2.3, table 9.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Guest:
    """A participant of a keystore, and how it behaves."""

    name: str
    stack: Stack = PQSEC


@dataclass(frozen=True, slots=True, kw_only=True)
class Occasion:
    """Where and when two meet, and what the user would have them agree on."""

    keystore: Keystore
    domain: int
    now: datetime
    agreement: KeyAgreement | None = None
    """None: the profile's, or what the stacks ask for."""

    @property
    def profile(self) -> Profile:
        """Of the keystore."""
        return self.keystore.profile


def meet(occasion: Occasion, first: Guest, second: Guest) -> Report:
    """The handshake between two participants, and what it showed.

    A step that fails ends it, and is the last in the report. KeystoreError if a
    participant is not there at all.
    """
    for guest in (first, second):
        occasion.keystore.refuse_unknown(guest.name)
    meeting = Meeting(occasion)
    with suppress(StoppedError):
        encounter = meeting.prepare(first, second)
        meeting.hold(encounter)
    return meeting.report()


class Seated(NamedTuple):
    """A participant that is there, and how it behaves."""

    participant: Credentials
    stack: Stack


def fetched(keystore: Keystore, name: str, steps: Steps) -> Credentials:
    """The participant of that name, as it lies in the keystore. StoppedError if unreadable."""
    name = regular_name(name)
    with steps.step(f"files of {name}") as detail:
        try:
            participant = keystore.participant(name)
        except PqsecError as error:
            error.hint = error.hint or f"restore it from a backup; or make it anew: {renewal(name)}"
            raise
        detail.append("keys, certificates, permissions and governance read")
    return participant


def vetted(occasion: Occasion, seated: Seated, steps: Steps) -> None:
    """Its own identity and documents are sound, for itself and its stack. StoppedError if not."""
    (participant, stack), now = seated, occasion.now
    profile, domain = occasion.profile, occasion.domain
    with steps.step(f"identity of {participant.name}") as detail:
        detail.append(check_identity(participant, profile, now))
        stack.check_identity(participant.certificate, participant.identity_ca)
    with steps.step(f"documents of {participant.name}") as detail:
        try:
            detail.append(check_documents(participant, domain, now))
        except VerificationError as error:
            if Code.NO_DOMAIN_RULE in error.codes:
                error.hint = _to_add_domain(occasion.keystore)
            raise
        stack.check_documents_ca(participant.permissions_ca)


def _to_add_domain(keystore: Keystore) -> str:
    """How its governance is made to name one more domain, for a hint."""
    folder = shlex.quote(str(keystore.root))
    document = shlex.quote(str(keystore.root / "enclaves/governance.xml"))
    return (
        f"add the domain to {document} and run `pqsec -k {folder} sign-governance {document}"
        " --force`; the permissions must name the domain too"
    )


@dataclass(slots=True)
class Meeting:
    """A meeting as it goes: first each participant by itself, then both."""

    occasion: Occasion
    steps: Steps = field(default_factory=Steps)
    course: Course | None = None

    def prepare(self, first: Guest, second: Guest) -> Encounter:
        """Both participants, found sound, and who speaks first. StoppedError if not."""
        return self.seat(self._arrived(first), self._arrived(second))

    def seat(self, one: Seated, other: Seated) -> Encounter:
        """Who speaks first, of two that are sound by themselves. StoppedError if nobody can."""
        with self.steps.step("who speaks first") as detail:
            if one.participant.name == other.participant.name:
                raise VerificationError(
                    f"both are {one.participant.name}: a participant cannot meet itself",
                    hint="name two different participants",
                )
            encounter = self._cast(one, other)
            self.course = Course(encounter, self.steps)
            detail.append(_why(encounter))
        return encounter

    def hold(self, encounter: Encounter) -> None:
        """The handshake and what follows. StoppedError where it fails."""
        self.course = Course(encounter, self.steps)
        self.course.run()

    def report(self) -> Report:
        """What was found up to now."""
        course = self.course
        encounter = course.encounter if course else None
        wanted = self.occasion.agreement or self.occasion.profile.key_agreement
        return Report(
            steps=tuple(self.steps.done),
            initiator=encounter.initiator.name if encounter else None,
            replier=encounter.replier.name if encounter else None,
            why=_why(encounter) if encounter else None,
            stacks={side.name: side.stack.name for side in encounter.sides} if encounter else {},
            signature=_signatures(encounter) if encounter else None,
            key_agreement=(encounter.agreement if encounter else wanted).wire_name,
            milliseconds=round(course.seconds * 1000, 3) if course else 0.0,
            sent=tuple(course.sent) if course else (),
            outcome=course.done[1] if course and course.done else None,
        )

    def _arrived(self, guest: Guest) -> Seated:
        """The participant, if it can be read and its own credentials are sound."""
        participant = fetched(self.occasion.keystore, guest.name, self.steps)
        seated = Seated(participant, guest.stack)
        vetted(self.occasion, seated, self.steps)
        return seated

    def _cast(self, one: Seated, other: Seated) -> Encounter:
        """Who initiates: the smaller GUID speaks first."""
        sides = self._side(one, other.stack), self._side(other, one.stack)
        if not initiates(sides[0].guid, sides[1].guid):
            sides = sides[::-1]
        initiator, replier = sides
        occasion = self.occasion
        return Encounter(
            initiator=initiator,
            replier=replier,
            agreement=asked(initiator.stack, replier.stack, occasion.profile, occasion.agreement),
            profile=occasion.profile,
            domain=occasion.domain,
            now=occasion.now,
        )

    def _side(self, seated: Seated, peer: Stack) -> Side:
        """What a participant shows and insists on when its peer behaves like that."""
        participant, own = seated
        second = None if own.is_stock or peer.is_stock else participant.alternative_key
        identity = Identity(
            certificate=participant.certificate,
            key=pair_private(participant.key, second) if second else participant.key,
            ca=participant.identity_ca,
            guid=adjusted_guid(participant.certificate.subject_der, os.urandom(12) + _ENTITY_ID),
            permissions=participant.permissions,
            revocation_list=participant.revocation_list,
        )
        demands = policy(own, peer, self.occasion.profile, self.occasion.agreement)
        return Side(
            participant=participant,
            stack=own,
            terms=Terms(own=identity, policy=demands, dialect=own.dialect),
        )


def _why(encounter: Encounter) -> str:
    initiator, replier = encounter.sides
    mine, theirs = initiator.guid[:6].hex(), replier.guid[:6].hex()
    return (
        f"{initiator.name} initiates: its GUID is smaller ({mine} < {theirs});"
        " these bits come from the subject name, so it is so every time"
    )


def _signatures(encounter: Encounter) -> str:
    names = [side.terms.own.key.algorithm.wire_name for side in encounter.sides]
    return names[0] if names[0] == names[1] else ", ".join(names)
