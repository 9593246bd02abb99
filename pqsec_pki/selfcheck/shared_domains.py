"""The domains that two participants may both join, and the topics that they share on them."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import may_join, topics_between
from pqsec_pki.algorithms import KeyAgreement
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.handshake import FIRST_ONLY, StockPeers, WireVersion
from pqsec_pki.keystore import Keystore, regular_name
from pqsec_pki.selfcheck.handshake_check import (
    HandshakeCheck,
    HandshakeParty,
    HandshakeSetup,
    LoadedParty,
    check_party,
    load_party,
    run_handshake,
)
from pqsec_pki.selfcheck.report import HandshakeReport, Steps, StoppedError, TopicFlow
from pqsec_pki.selfcheck.stacks import PQSEC, SimulatedStack


@dataclass(frozen=True, slots=True)
class JoinableDomains:
    """The domains that each of several participants may join."""

    domains: dict[str, frozenset[int]]
    """The domain IDs that each may join, by its name; no signature is verified here."""
    fallback: int
    """The domain ID to use for a participant that may join none, to show what is wrong."""

    @classmethod
    def of(cls, setup: HandshakeSetup, names: Sequence[str]) -> "JoinableDomains":
        """KeystoreError if one of them does not exist, FileError if it cannot be read."""
        found = dict[str, frozenset[int]]()
        for name in map(regular_name, names):
            setup.keystore.refuse_unknown(name)
            found[name] = frozenset()
            with suppress(StoppedError):
                load_party(setup, name, Steps())
                found[name], _ = domains_of(setup, name)
        somewhere = frozenset[int]().union(*found.values())
        return cls(found, min(somewhere or setup.keystore.domains.ids()))

    @property
    def shared(self) -> tuple[int, ...]:
        """The domain IDs that all may join, ascending."""
        return tuple(sorted(frozenset.intersection(*self.domains.values())))

    @property
    def is_split(self) -> bool:
        """Whether each may join a domain, but there is none that all may join."""
        return not self.shared and all(self.domains.values())

    @property
    def domain(self) -> int:
        """The domain ID for the handshake, if none was given."""
        return min(self.shared, default=self.fallback)

    def __str__(self) -> str:
        """Text such as `/a may join domain 0, /b domains 1, 2`."""
        return ", ".join(
            f"{name} may join domain{'s' if len(each) > 1 else ''} {_listed(each)}"
            for name, each in self.domains.items()
        )

    def refuse_split(self) -> None:
        """VerificationError if they share no domain."""
        if self.is_split:
            raise VerificationError(
                f"they share no domain: {self}",
                hint="`pqsec explain --participant NAME --join` shows which rules decide that",
            )


def verify_handshake(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    first: str,
    second: str,
    *,
    now: datetime,
    domain: int | None = None,
    stacks: tuple[SimulatedStack, SimulatedStack] = (PQSEC, PQSEC),
    agreement: KeyAgreement | None = None,
    versions: tuple[WireVersion, ...] = FIRST_ONLY,
    stock: StockPeers | None = None,
) -> HandshakeReport:
    """Run the handshake between two participants, and report its steps and their common topics.

    The report ends at the first step that fails. Without `domain`, the handshake is on the first
    domain that both may join; if there is none, each is checked alone, and the step `common
    domain` fails. `stacks` are those that the two behave like; `agreement` replaces the
    profile's key agreement; pqsec's messages have one of `versions`. With `stock`, of a keystore
    with several sets, each side chooses the set as pqsec's plugin does. KeystoreError if a
    participant does not exist.
    """
    setup = HandshakeSetup(
        keystore=keystore,
        domain=domain or 0,
        now=now,
        agreement=agreement,
        versions=versions,
        stock=stock,
    )
    joinable = JoinableDomains.of(setup, (first, second))
    if domain is None:
        setup = replace(setup, domain=joinable.domain)
    names = regular_name(first), regular_name(second)
    parties = [
        HandshakeParty(name=name, stack=stack) for name, stack in zip(names, stacks, strict=True)
    ]
    if joinable.is_split and domain is None:
        return _apart(setup, joinable, parties)
    report = replace(run_handshake(setup, *parties), domain=setup.domain, shared=joinable.shared)
    if not report.ok:
        return report
    return replace(report, talks=talks_between(setup, *names))


def _apart(
    setup: HandshakeSetup, joinable: JoinableDomains, parties: Sequence[HandshakeParty]
) -> HandshakeReport:
    """Check each on a domain that it may join; then the step `common domain` fails."""
    check = HandshakeCheck(setup)
    with suppress(StoppedError):
        for party, domains in zip(parties, joinable.domains.values(), strict=True):
            participant = load_party(setup, party.name, check.steps)
            here = replace(setup, domain=min(domains))
            check_party(here, LoadedParty(participant, party.stack), check.steps)
        with check.steps.step("common domain"):
            joinable.refuse_split()
    return check.report()


def domains_of(setup: HandshakeSetup, name: str) -> tuple[frozenset[int], set[int]]:
    """The domain IDs it may join, and those its governance names; no signature is verified."""
    try:
        own = setup.documents(name)
        named = {each for rule in own.governance.domain_rules for each in rule.domains.ids()}
        return frozenset(
            domain
            for domain in named
            if may_join(own.governance, own.permissions, own.subject, domain, setup.now).allowed
        ), named
    except PqsecError:
        return frozenset(), set()


def talks_between(setup: HandshakeSetup, one: str, other: str) -> tuple[TopicFlow, ...]:
    """The topics that one may publish and the other subscribe to, in both directions."""
    domain, now = setup.domain, setup.now
    ways = ((one, other), (other, one))
    return tuple(
        TopicFlow(*way, topics_between(*map(setup.documents, way), domain=domain, now=now))
        for way in ways
    )


def _listed(domains: frozenset[int]) -> str:
    return ", ".join(map(str, sorted(domains)))
