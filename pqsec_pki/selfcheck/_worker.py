"""What one process does where many meet: look at participants, and let pairs of them meet.

Everything that passes between processes is names, numbers and steps: no key leaves one.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from pqsec_pki.access.sharing import ParticipantDocuments
from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.credentials import Credentials
from pqsec_pki.keystore import Keystore
from pqsec_pki.selfcheck.meeting import Meeting, Occasion, Seated, fetched, vetted
from pqsec_pki.selfcheck.report import Step, Steps, StoppedError, Talk
from pqsec_pki.selfcheck.shared_domains import documents_of, domains_of, talks_between
from pqsec_pki.selfcheck.stacks import PQSEC, stack_named


@dataclass(frozen=True, slots=True, kw_only=True)
class Gathering:
    """Who is to meet, and how: all participants of a keystore, each two."""

    root: Path
    """Of the keystore."""
    now: datetime
    domain: int | None = None
    """Where all meet; None: each two on the first domain that both may join."""
    key_agreement: str | None = None
    """By name; None: the profile's, or what the stacks ask for."""
    stacks: tuple[str, str] = (PQSEC.name, PQSEC.name)
    """How the two of a pair behave; if they differ, each pair meets both ways round."""


class Seat(NamedTuple):
    """A participant that behaves like that stack; both by name."""

    name: str
    stack: str


class Pair(NamedTuple):
    """Two that meet, and where."""

    first: Seat
    second: Seat
    domain: int


@dataclass(frozen=True, slots=True)
class Finding:
    """What is to be said of one by itself: where it may join, and what is wrong with it."""

    seat: Seat
    domains: frozenset[int]
    failed: Step | None


class Result(NamedTuple):
    """How a pair met. None: not reached."""

    initiator: str | None
    replier: str | None
    failed: Step | None
    milliseconds: float
    talks: tuple[Talk, ...] = ()
    """What each may publish and the other subscribe to, once they have met."""

    @property
    def shares_no_topic(self) -> bool:
        """Whether they have met, and share no topic."""
        return self.failed is None and not any(each.topics for each in self.talks)


@dataclass(slots=True)
class Worker:
    """Does the work for one gathering, and remembers what it read."""

    gathering: Gathering
    occasion: Occasion
    _read: dict[str, Credentials] = field(default_factory=dict)
    _documents: dict[str, ParticipantDocuments] = field(default_factory=dict)

    @classmethod
    def of(cls, gathering: Gathering) -> "Worker":
        """KeystoreError if there is no keystore, UnknownAlgorithmError for an unknown name."""
        wanted = gathering.key_agreement
        occasion = Occasion(
            keystore=Keystore.open(gathering.root),
            domain=gathering.domain or 0,
            now=gathering.now,
            agreement=None if wanted is None else KEY_AGREEMENTS.named(wanted),
        )
        return cls(gathering, occasion)

    def look_at(self, seats: Sequence[Seat]) -> list[Finding]:
        """Each by itself."""
        return [self._finding(seat) for seat in seats]

    def let_meet(self, pairs: Sequence[Pair | None]) -> list[Result | None]:
        """Each two, whose own credentials are known to be sound; None where there are none."""
        return [self._result(pair) if pair else None for pair in pairs]

    def _finding(self, seat: Seat) -> Finding:
        steps, domains = Steps(), frozenset[int]()
        with suppress(StoppedError):
            participant = self._participant(seat.name, steps)
            domains, named = domains_of(participant, self.gathering.now)
            # Where it may join none, one that is named tells why not.
            occasion = replace(self.occasion, domain=min(domains or named or {0}))
            vetted(occasion, Seated(participant, stack_named(seat.stack)), steps)
            return Finding(seat, domains, None)
        return Finding(seat, domains, steps.done[-1])

    def _result(self, pair: Pair) -> Result:
        meeting = Meeting(replace(self.occasion, domain=pair.domain))
        with suppress(StoppedError):
            one, other = (self._seated(seat, meeting.steps) for seat in (pair.first, pair.second))
            meeting.hold(meeting.seat(one, other))
        found = meeting.report()
        talks = () if found.failed else self._talks(pair)
        return Result(found.initiator, found.replier, found.failed, found.milliseconds, talks)

    def _talks(self, pair: Pair) -> tuple[Talk, ...]:
        names = pair.first.name, pair.second.name
        for name in names:
            if name not in self._documents:
                self._documents[name] = documents_of(self._read[name])
        one, other = ((name, self._documents[name]) for name in names)
        return talks_between(one, other, pair.domain, self.gathering.now)

    def _seated(self, seat: Seat, steps: Steps) -> Seated:
        return Seated(self._participant(seat.name, steps), stack_named(seat.stack))

    def _participant(self, name: str, steps: Steps) -> Credentials:
        """Read once."""
        if name not in self._read:
            self._read[name] = fetched(self.occasion.keystore, name, steps)
        return self._read[name]
