"""Run the handshake of every two participants of a keystore that share a domain.

Each participant is checked once alone; then the pairs are run in several processes. Results
come one by one, in the order of the names, so that half a million of them take no memory.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations, islice
from typing import TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.selfcheck._pool import WorkerPool, worker_pool
from pqsec_pki.selfcheck._worker import (
    AllPairsJob,
    PairResult,
    ParticipantCheck,
    ParticipantPair,
    PartyRef,
    Worker,
)
from pqsec_pki.selfcheck.report import CheckedStep

__all__ = [
    "AllPairsJob",
    "PairOutcome",
    "PairResult",
    "PairsCheck",
    "ParticipantCheck",
    "PartyRef",
    "check_pairs",
    "count_pairs",
]

BLOCK = 16
"""Pairs or participants in one block of work: about an eighth of a second."""
WORTH_A_PROCESS = 64
"""Pairs that are done in the time that one more process takes to start."""

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class PairOutcome:
    """The outcome for a pair. `result` is None if their handshake was not run."""

    first: ParticipantCheck
    second: ParticipantCheck
    domain: int | None
    """None: they share no domain."""
    result: PairResult | None = None

    @property
    def failed(self) -> CheckedStep | None:
        """The failed step of one of them, or of their handshake."""
        of_both = self.result.failed if self.result else None
        return self.first.failed or self.second.failed or of_both

    @property
    def ok(self) -> bool | None:
        """Whether the handshake succeeded; None if they share no domain."""
        if self.failed:
            return False
        return None if self.domain is None else True

    def to_json(self) -> dict[str, object]:
        """The outcome for --json; with the fault, if there is one."""
        result = self.result
        return {
            "pair": [self.first.party.name, self.second.party.name],
            "as": [self.first.party.stack, self.second.party.stack],
            "domain": self.domain,
            "ok": self.ok,
            "initiator": result.initiator if result else None,
            "replier": result.replier if result else None,
            "milliseconds": result.milliseconds if result else None,
            "topic_flows": [each.to_json() for each in result.talks] if result else [],
            **(self.failed.fault if self.failed else {}),
        }


@dataclass(frozen=True, slots=True)
class PairsCheck:
    """All participants of a keystore, each checked alone."""

    findings: dict[PartyRef, ParticipantCheck]
    job: AllPairsJob
    _pool: WorkerPool

    @property
    def names(self) -> list[str]:
        """The participants, sorted."""
        return sorted({party.name for party in self.findings})

    def participants_json(self) -> list[dict[str, object]]:
        """Each participant for --json, with the domains that it may join and its faults."""
        return [self._participant_json(name) for name in self.names]

    def _participant_json(self, name: str) -> dict[str, object]:
        own = [each for party, each in self.findings.items() if party.name == name]
        return {
            "name": name,
            "domains": sorted(own[0].domains),
            "faults": [
                {"as": each.party.stack, **each.failed.fault} for each in own if each.failed
            ],
        }

    def outcomes(self) -> Iterator[PairOutcome]:
        """The outcome of each pair; its first participant behaves like the first stack of the job.

        PqsecError if a process is killed.
        """
        planned: deque[list[PairOutcome]] = deque()

        def blocks() -> Iterator[list[ParticipantPair | None]]:
            for block in _blocks(self._plans()):
                planned.append(block)
                yield [_to_meet(each) for each in block]

        for results in self._pool.map(Worker.run_pairs, blocks()):
            for plan, result in zip(planned.popleft(), results, strict=True):
                yield PairOutcome(plan.first, plan.second, plan.domain, result)

    def _plans(self) -> Iterator[PairOutcome]:
        one, other = self.job.stacks
        for first, second in combinations(self.names, 2):
            yield self._plan(PartyRef(first, one), PartyRef(second, other))
            if one != other:
                yield self._plan(PartyRef(second, one), PartyRef(first, other))

    def _plan(self, first: PartyRef, second: PartyRef) -> PairOutcome:
        one, other = self.findings[first], self.findings[second]
        shared, wanted = one.domains & other.domains, self.job.domain
        if wanted is not None:
            shared &= {wanted}
        return PairOutcome(one, other, min(shared, default=None))


def count_pairs(names: Sequence[str], job: AllPairsJob) -> int:
    """The number of outcomes."""
    return len(names) * (len(names) - 1) // 2 * len(set(job.stacks))


@contextmanager
def check_pairs(
    job: AllPairsJob,
    names: Sequence[str],
    jobs: int,
    progress: Callable[[Iterable[ParticipantCheck]], Iterable[ParticipantCheck]] = iter,
) -> Iterator[PairsCheck]:
    """Check the participants called `names`, each alone, with `jobs` processes.

    KeystoreError if there is no keystore; PqsecError if a process is killed.
    """
    useful = 1 + count_pairs(names, job) // WORTH_A_PROCESS
    parties = (PartyRef(name, stack) for name in names for stack in dict.fromkeys(job.stacks))
    with worker_pool(job, min(jobs, useful)) as workers:
        looks = workers.map(Worker.check_parties, _blocks(parties))
        findings = {each.party: each for each in progress(each for look in looks for each in look)}
        yield PairsCheck(findings, job, workers)


def _blocks(items: Iterable[Item]) -> Iterator[list[Item]]:
    rest = iter(items)
    while block := list(islice(rest, BLOCK)):
        yield block


def _to_meet(plan: PairOutcome) -> ParticipantPair | None:
    if plan.failed or plan.domain is None:
        return None
    return ParticipantPair(plan.first.party, plan.second.party, plan.domain)
