"""Run the handshake of two participants of a keystore in memory, as two DDS processes would."""

import os
import shlex
from contextlib import suppress
from dataclasses import field, replace
from datetime import datetime
from typing import NamedTuple, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import ParticipantDocuments
from pqsec_pki.algorithms import KeyAgreement, Profile, pair_private
from pqsec_pki.credentials import Credentials
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.handshake import (
    FIRST_ONLY,
    Identity,
    StockPeers,
    Terms,
    WireVersion,
    adjusted_guid,
    check_carried,
    initiates,
)
from pqsec_pki.keystore import Keystore, layout, regular_name
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck.credentials import check_documents, check_identity, renewal
from pqsec_pki.selfcheck.report import HandshakeReport, Steps, StoppedError
from pqsec_pki.selfcheck.run import HandshakeRun
from pqsec_pki.selfcheck.session import HandshakeSession, SessionSide
from pqsec_pki.selfcheck.sets import PartyInSets, sides_by_policy
from pqsec_pki.selfcheck.stacks import PQSEC, SimulatedStack, asked, policy
from pqsec_pki.smime import document_in

_ENTITY_ID = bytes.fromhex("000001c1")
"""ENTITYID_PARTICIPANT (RTPS 2.3, table 9.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandshakeParty:
    """A participant of a keystore, and the stack it behaves like."""

    name: str
    stack: SimulatedStack = PQSEC


@dataclass(frozen=True, slots=True, kw_only=True)
class HandshakeSetup:
    """The keystore, domain, time and key agreement of a handshake."""

    keystore: Keystore
    domain: int
    now: datetime
    agreement: KeyAgreement | None = None
    """None: the profile's, or the one that the stacks ask for."""
    versions: tuple[WireVersion, ...] = FIRST_ONLY
    """The versions of messages that pqsec sends and accepts, the first one preferred."""
    stock: StockPeers | None = None
    """Of a keystore with several sets: who may be met with the first one; participants then choose
    the set as pqsec's plugin does. None: the keystore's own set is used."""
    _read: dict[str, Credentials] = field(default_factory=dict, compare=False, repr=False)
    _documents: dict[str, ParticipantDocuments] = field(
        default_factory=dict, compare=False, repr=False
    )

    @property
    def profile(self) -> Profile:
        """The keystore's profile."""
        return self.keystore.profile

    def in_set(self, keystore: Keystore) -> Self:
        """The same for one set of the keystore."""
        return replace(self, keystore=keystore, stock=None, _read={}, _documents={})

    def participant(self, name: str) -> Credentials:
        """The participant of that name, read from the keystore once; errors as of a keystore."""
        name = regular_name(name)
        if name not in self._read:
            self._read[name] = self.keystore.participant(name)
        return self._read[name]

    def documents(self, name: str) -> ParticipantDocuments:
        """Its subject and documents, not verified; MalformedError, or others, if unreadable."""
        name = regular_name(name)
        if name not in self._documents:
            own = self.participant(name)
            self._documents[name] = ParticipantDocuments(
                subject=own.certificate.subject_name,
                governance=Governance.from_xml(document_in(own.governance)),
                permissions=Permissions.from_xml(document_in(own.permissions)),
            )
        return self._documents[name]


def run_handshake(
    setup: HandshakeSetup, first: HandshakeParty, second: HandshakeParty
) -> HandshakeReport:
    """Run the handshake between two participants, and report its steps.

    It ends at the first step that fails, the last in the report. KeystoreError if a
    participant does not exist.
    """
    for party in (first, second):
        setup.keystore.refuse_unknown(party.name)
    check = HandshakeCheck(setup)
    with suppress(StoppedError):
        session = check.prepare(first, second)
        check.perform(session)
    return check.report()


class LoadedParty(NamedTuple):
    """A participant as it was read, and the stack it behaves like."""

    participant: Credentials
    stack: SimulatedStack


def load_party(setup: HandshakeSetup, name: str, steps: Steps) -> Credentials:
    """The participant of that name. StoppedError if it is unreadable."""
    name = regular_name(name)
    with steps.step(f"files of {name}") as detail:
        try:
            participant = setup.participant(name)
        except PqsecError as error:
            error.hint = error.hint or f"restore it from a backup, or reissue it: {renewal(name)}"
            raise
        detail.append("keys, certificates, permissions and governance read")
    return participant


def check_party(setup: HandshakeSetup, loaded: LoadedParty, steps: Steps) -> None:
    """Check its own identity and documents, also for its stack. StoppedError if invalid."""
    (participant, stack), now = loaded, setup.now
    profile, domain = setup.profile, setup.domain
    with steps.step(f"identity of {participant.name}") as detail:
        detail.append(check_identity(participant, profile, now))
        stack.check_identity(participant.certificate, participant.identity_ca)
    with steps.step(f"documents of {participant.name}") as detail:
        try:
            detail.append(check_documents(participant, domain, now, stack))
        except VerificationError as error:
            if Code.NO_DOMAIN_RULE in error.codes:
                error.hint = _to_add_domain(setup.keystore)
            raise
        stack.check_documents_ca(participant.permissions_ca)
        if WireVersion.SECOND in setup.versions and not stack.is_stock:
            check_carried(participant.certificate.pem, participant.permissions)


def _to_add_domain(keystore: Keystore) -> str:
    """A hint how to add a domain to the keystore's governance."""
    folder = shlex.quote(str(keystore.root))
    document = shlex.quote(str(keystore.folder / layout.ENCLAVES / layout.GOVERNANCE_XML))
    return (
        f"add the domain to {document} and run `pqsec -k {folder} sign-governance {document}"
        " --force`; the permissions must name the domain too"
    )


@dataclass(slots=True)
class HandshakeCheck:
    """The checks of each participant alone, then their handshake."""

    setup: HandshakeSetup
    steps: Steps = field(default_factory=Steps)
    run: HandshakeRun | None = None

    def prepare(self, first: HandshakeParty, second: HandshakeParty) -> HandshakeSession:
        """Check both participants, and decide which initiates. StoppedError if a check fails."""
        if self.setup.stock is None:
            return self.pair(self._load(first), self._load(second))
        parties = self._in_sets(first, second.stack), self._in_sets(second, first.stack)
        with self.steps.step("initiator") as detail:
            _refuse_one(first.name, second.name)
            session = self._by_policy(*parties, self.setup.stock)
            self.run = HandshakeRun(session, self.steps)
            detail.append(_why(session))
        return session

    def pair(self, one: LoadedParty, other: LoadedParty) -> HandshakeSession:
        """Decide which of two valid participants initiates. StoppedError if neither can."""
        with self.steps.step("initiator") as detail:
            _refuse_one(one.participant.name, other.participant.name)
            session = self._assign_roles(one, other)
            self.run = HandshakeRun(session, self.steps)
            detail.append(_why(session))
        return session

    def perform(self, session: HandshakeSession) -> None:
        """The handshake, the permissions and a protected message. StoppedError where it fails."""
        self.run = HandshakeRun(session, self.steps)
        self.run.perform()

    def report(self) -> HandshakeReport:
        """The report of the steps so far."""
        run = self.run
        session = run.session if run else None
        wanted = self.setup.agreement or self.setup.profile.key_agreement
        return HandshakeReport(
            steps=tuple(self.steps.done),
            initiator=session.initiator.name if session else None,
            replier=session.replier.name if session else None,
            why=_why(session) if session else None,
            stacks={side.name: side.stack.name for side in session.sides} if session else {},
            signature=_signatures(session) if session else None,
            key_agreement=(session.agreement if session else wanted).wire_name,
            milliseconds=round(run.seconds * 1000, 3) if run else 0.0,
            sent=tuple(run.sent) if run else (),
            outcome=run.done[1] if run and run.done else None,
        )

    def _load(self, party: HandshakeParty) -> LoadedParty:
        """The participant, once it was read and its own credentials are valid."""
        participant = load_party(self.setup, party.name, self.steps)
        loaded = LoadedParty(participant, party.stack)
        check_party(self.setup, loaded, self.steps)
        return loaded

    def _in_sets(self, party: HandshakeParty, peer: SimulatedStack) -> PartyInSets:
        """The participant in each set that it has; a stock stack has the first one."""
        sets = self.setup.keystore.sets[: 1 if party.stack.is_stock else None]
        checks = [HandshakeCheck(self.setup.in_set(each), self.steps) for each in sets]
        sides = [each._side(each._load(party), peer) for each in checks]  # noqa: SLF001 -- its own
        return PartyInSets.of([each.profile for each in sets], sides)

    def _by_policy(
        self, one: PartyInSets, other: PartyInSets, stock: StockPeers
    ) -> HandshakeSession:
        """The session in which each side chooses the set as its policy says."""
        initiator, replier, profile = sides_by_policy(one, other, stock)
        return self._session(initiator, replier, profile)

    def _session(
        self, initiator: SessionSide, replier: SessionSide, profile: Profile
    ) -> HandshakeSession:
        setup = self.setup
        return HandshakeSession(
            initiator=initiator,
            replier=replier,
            agreement=asked(initiator.stack, replier.stack, profile, setup.agreement),
            profile=profile,
            domain=setup.domain,
            now=setup.now,
        )

    def _assign_roles(self, one: LoadedParty, other: LoadedParty) -> HandshakeSession:
        """Assign initiator and replier: the participant with the smaller GUID initiates."""
        sides = self._side(one, other.stack), self._side(other, one.stack)
        if not initiates(sides[0].guid, sides[1].guid):
            sides = sides[::-1]
        return self._session(*sides, self.setup.profile)

    def _side(self, loaded: LoadedParty, peer: SimulatedStack) -> SessionSide:
        """What a participant sends and requires, given the stack of its peer."""
        participant, own = loaded
        second = None if own.is_stock or peer.is_stock else participant.alternative_key
        identity = Identity(
            certificate=participant.certificate,
            key=pair_private(participant.key, second) if second else participant.key,
            ca=participant.identity_ca,
            guid=adjusted_guid(participant.certificate.subject_der, os.urandom(12) + _ENTITY_ID),
            permissions=participant.permissions,
            revocation_list=participant.revocation_list,
        )
        demands = policy(own, peer, self.setup.profile, self.setup.agreement)
        if not (own.is_stock or peer.is_stock):
            demands = replace(demands, versions=self.setup.versions)
        return SessionSide(
            participant=participant,
            stack=own,
            terms=Terms(own=identity, policy=demands, conventions=own.conventions),
        )


def _refuse_one(one: str, other: str) -> None:
    if regular_name(one) == regular_name(other):
        raise VerificationError(
            f"both are {regular_name(one)}: a participant has no handshake with itself",
            hint="name two different participants",
        )


def _why(session: HandshakeSession) -> str:
    initiator, replier = session.sides
    mine, theirs = initiator.guid[:6].hex(), replier.guid[:6].hex()
    return (
        f"{initiator.name} initiates: its GUID is smaller ({mine} < {theirs});"
        " these bits come from the subject name, so this never changes"
    )


def _signatures(session: HandshakeSession) -> str:
    names = [side.terms.own.key.algorithm.wire_name for side in session.sides]
    return names[0] if names[0] == names[1] else ", ".join(names)
