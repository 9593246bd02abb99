"""What one worker process does: check participants, and run handshakes of pairs.

Only names, numbers and steps pass between processes; no key does.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.handshake import FIRST_ONLY, WireVersion
from pqsec_pki.keystore import Keystore
from pqsec_pki.selfcheck.handshake_check import (
    HandshakeCheck,
    HandshakeSetup,
    LoadedParty,
    check_party,
    load_party,
)
from pqsec_pki.selfcheck.report import CheckedStep, Steps, StoppedError, TopicFlow
from pqsec_pki.selfcheck.shared_domains import domains_of, talks_between
from pqsec_pki.selfcheck.stacks import PQSEC, stack_named


@dataclass(frozen=True, slots=True, kw_only=True)
class AllPairsJob:
    """Handshakes between every two participants of a keystore, and their options."""

    root: Path
    """The keystore's folder."""
    now: datetime
    domain: int | None = None
    """The domain ID for all pairs; None: for each pair the first domain that both may join."""
    key_agreement: str | None = None
    """Its name; None: the profile's, or the one that the stacks ask for."""
    stacks: tuple[str, str] = (PQSEC.name, PQSEC.name)
    """Names of the stacks of a pair; if they differ, each pair is run in both assignments."""
    versions: tuple[WireVersion, ...] = FIRST_ONLY
    """The versions of pqsec's messages."""
    profile: str | None = None
    """The profile whose set of credentials is used; None for the first set."""


class PartyRef(NamedTuple):
    """The name of a participant, and the name of the stack it behaves like."""

    name: str
    stack: str


class ParticipantPair(NamedTuple):
    """Two participants, and the domain ID of their handshake."""

    first: PartyRef
    second: PartyRef
    domain: int


@dataclass(frozen=True, slots=True)
class ParticipantCheck:
    """The result for one participant alone: the domains it may join, and what is wrong with it."""

    party: PartyRef
    domains: frozenset[int]
    failed: CheckedStep | None


class PairResult(NamedTuple):
    """The result of a pair's handshake. None: not reached."""

    initiator: str | None
    replier: str | None
    failed: CheckedStep | None
    milliseconds: float
    talks: tuple[TopicFlow, ...] = ()
    """The topics that one may publish and the other subscribe to, if the handshake succeeded."""

    @property
    def shares_no_topic(self) -> bool:
        """Whether the handshake succeeded, but they share no topic."""
        return self.failed is None and not any(each.topics for each in self.talks)


@dataclass(slots=True)
class Worker:
    """Does the work for one all-pairs job; its setup caches what was read."""

    job: AllPairsJob
    setup: HandshakeSetup

    @classmethod
    def of(cls, job: AllPairsJob) -> "Worker":
        """KeystoreError if there is no keystore, UnknownAlgorithmError for an unknown name."""
        wanted, opened = job.key_agreement, Keystore.open(job.root)
        setup = HandshakeSetup(
            keystore=opened.of_profile(job.profile) if job.profile else opened,
            domain=job.domain or 0,
            now=job.now,
            agreement=None if wanted is None else KEY_AGREEMENTS.named(wanted),
            versions=job.versions,
        )
        return cls(job, setup)

    def check_parties(self, parties: Sequence[PartyRef]) -> list[ParticipantCheck]:
        """Check each participant alone."""
        return [self._finding(party) for party in parties]

    def run_pairs(self, pairs: Sequence[ParticipantPair | None]) -> list[PairResult | None]:
        """Run each pair, whose own credentials were found valid; None for None."""
        return [self._result(pair) if pair else None for pair in pairs]

    def _finding(self, party: PartyRef) -> ParticipantCheck:
        steps, domains = Steps(), frozenset[int]()
        with suppress(StoppedError):
            loaded = self._loaded(party, steps)
            domains, named = domains_of(self.setup, party.name)
            # If it may join no domain, check one that its governance names: that shows why not.
            setup = replace(self.setup, domain=min(domains or named or {0}))
            check_party(setup, loaded, steps)
            return ParticipantCheck(party, domains, None)
        return ParticipantCheck(party, domains, steps.done[-1])

    def _result(self, pair: ParticipantPair) -> PairResult:
        setup = replace(self.setup, domain=pair.domain)
        check = HandshakeCheck(setup)
        with suppress(StoppedError):
            one, other = (self._loaded(party, check.steps) for party in (pair.first, pair.second))
            check.perform(check.pair(one, other))
        found = check.report()
        names = pair.first.name, pair.second.name
        talks = () if found.failed else talks_between(setup, *names)
        return PairResult(found.initiator, found.replier, found.failed, found.milliseconds, talks)

    def _loaded(self, party: PartyRef, steps: Steps) -> LoadedParty:
        return LoadedParty(load_party(self.setup, party.name, steps), stack_named(party.stack))
