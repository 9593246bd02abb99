"""Simulates the fleet by discrete events: announcements, messages, timers, processors, memory.

A fleet with too many pairs is represented by a smaller one, whose participants do the
same work and have the same memory for each peer: the work, not the number of peers, decides when
a pair meets.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import field, replace
from heapq import heappop, heappush, heapreplace
from random import Random
from statistics import median

from pqsec_pki._dataclass import dataclass
from pqsec_pki.estimation.scenario import (
    ANNOUNCE,
    ANSWER,
    ANSWERS,
    BASE,
    FINALS,
    GIVE_UP,
    LATE,
    LATE_SHARE,
    REASSEMBLY,
    RESEND,
    SETTLE,
    Scenario,
)
from pqsec_pki.stacks import FRAME_MEMORY

MOST_PAIRS = 5_000
"""Pairs of all runs together: a second or two, and a few megabytes."""
MOST_RUNS = 200
_MILLI = 1000
_ANSWERED, _SENT, _DONE = 1, 2, 4
"""Bits of a pair: the responder works on its Reply, the initiator on its Final, both have met."""

_BOTH = 3
"""Each side of a pair was heard by the other: a bit for each."""

Event = tuple[float, int, Callable[..., None], tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class Simulated:
    """The times of all runs."""

    runs: int
    participants: int
    """The participants of each run: fewer than in the fleet, if that is too large."""
    events: int
    pairs: tuple[float, ...] = field(repr=False)
    """Seconds until each pair of each run had met, sorted; `inf` if it gave up."""
    meshes: tuple[float, ...] = field(repr=False)
    """Seconds until the last pair of each run had met, sorted."""

    @property
    def is_whole(self) -> bool:
        """Whether it was the fleet itself, in more than one run."""
        return self.runs > 1

    def apart(self, time: float) -> float:
        """The share of pairs that have not met `time` seconds after the first start."""
        return sum(each > time for each in self.pairs) / len(self.pairs)

    def pair(self, share: float) -> float:
        """Seconds until that share of the pairs has met."""
        return self.pairs[min(int(share * len(self.pairs)), len(self.pairs) - 1)]

    def mesh(self, probability: float) -> float:
        """Seconds until all have met, in that share of the runs."""
        if probability == 0.5:  # noqa: PLR2004 -- the median
            return median(self.meshes)
        return self.meshes[min(int(probability * len(self.meshes)), len(self.meshes) - 1)]


def simulated(scenario: Scenario, seed: int, most: int = MOST_PAIRS) -> Simulated:
    """Runs of the scenario, with at most `most` pairs in all; the same for the same seed."""
    random = Random(seed)  # noqa: S311 -- no secret
    small = _represented(scenario, most)
    runs = max(1, min(MOST_RUNS, most // small.pairs))
    pairs, meshes, events = list[float](), list[float](), 0
    for _ in range(runs):
        one = _Run(small, random)
        one.go()
        pairs += one.met
        meshes.append(max(one.met))
        events += one.events
    ordered = tuple(sorted(pairs))
    return Simulated(runs, small.participants, events, ordered, tuple(sorted(meshes)))


def _represented(scenario: Scenario, most: int) -> Scenario:
    """The scenario, or a smaller one with the same load on each host."""
    if scenario.pairs <= most:
        return scenario
    count = max(2, int((2 * most) ** 0.5))
    on_host = scenario.participants / scenario.host_count
    hosts = max(1, round(count / on_host))
    more = (scenario.participants - 1) / (count - 1) * on_host / (count / hosts)
    costs = scenario.costs
    dearer = replace(
        costs,
        initiator=costs.initiator * more,
        responder=costs.responder * more,
        stack=costs.stack * more,
        repeat=costs.repeat * more,
        start=costs.start * on_host / (count / hosts),
    )
    return replace(
        scenario,
        participants=count,
        hosts=hosts,
        costs=dearer,
        threshold=max(1, int(scenario.threshold / more)),
        each=scenario.each[:: max(1, len(scenario.each) // count)][:count],
    )


class _Run:
    """One start of the fleet."""

    def __init__(self, scenario: Scenario, random: Random) -> None:
        self._scenario, self._random = scenario, random
        self._loss, self._costs = scenario.loss, scenario.costs
        count = scenario.participants
        self._free = [[0.0] * scenario.cores for _ in range(scenario.host_count)]
        self._held: list[deque[tuple[float, int]]] = [deque() for _ in range(scenario.host_count)]
        self._holds = [0] * scenario.host_count
        self._starts = [random.uniform(0, scenario.start_within) for _ in range(count)]
        self._sides = [(one, two) for one in range(count) for two in range(one + 1, count)]
        random.shuffle(self._sides)
        self._began = [max(self._starts[a], self._starts[b]) for a, b in self._sides]
        self._state = bytearray(len(self._sides))
        self._known = bytearray(len(self._sides))
        self.met = [float("inf")] * len(self._sides)
        self.events = 0
        self._queue: list[Event] = []
        each = scenario.each or (scenario.sizes,)
        self._frames = [tuple(map(scenario.datagrams, one)) for one in each]
        self._whole = [tuple(map(scenario.delivery, one)) for one in each]

    def go(self) -> None:
        """Until all pairs have met, or given up."""
        for one, start in enumerate(self._starts):
            self._at(start, self._start, one)
        for pair, began in enumerate(self._began):
            one, two = self._sides[pair]
            later = int(self._starts[two] >= self._starts[one])
            self._at(began, self._announce, pair, later)
            together = self._starts[one] == self._starts[two]  # then both hear the first
            phase = 0.0 if together else self._random.uniform(0, ANNOUNCE)
            self._at(began + phase, self._announce, pair, 1 - later)
        while self._queue:
            time, _, run, words = heappop(self._queue)
            run(time, *words)

    def _at(self, time: float, run: Callable[..., None], *words: int) -> None:
        self.events += 1
        heappush(self._queue, (time, self.events, run, words))

    def _host(self, participant: int) -> int:
        return participant % self._scenario.host_count

    def _work(self, participant: int, now: float, milliseconds: float) -> float:
        """The time at which the host of `participant` has done it, in the order of arrival."""
        cores = self._free[self._host(participant)]
        end = max(now, cores[0]) + milliseconds / _MILLI
        heapreplace(cores, end)
        return end

    def _arrives(self, now: float, sender: int, receiver: int, message: int) -> bool:
        kinds = len(self._frames)
        frames = self._frames[sender % kinds][message]
        if max(frames) == 1:
            return self._random.random() < self._whole[sender % kinds][message]
        host = self._host(receiver)
        held, complete = self._held[host], True
        while held and held[0][0] <= now:
            self._holds[host] -= held.popleft()[1]
        for each in frames:
            room = self._holds[host] + each * FRAME_MEMORY <= self._scenario.threshold
            if room and self._random.random() < (1 - self._loss) ** each:
                continue
            complete = False
            if room and each > 1:
                part = round((1 - self._loss) * each * FRAME_MEMORY)
                held.append((now + REASSEMBLY, part))
                self._holds[host] += part
        return complete

    def _start(self, now: float, participant: int) -> None:
        self._work(participant, now, self._costs.start)

    def _announce(self, now: float, pair: int, side: int) -> None:
        """Announce a participant to all, repeatedly."""
        if self._known[pair] != _BOTH:
            self._heard(now, pair, side)
            self._at(now + ANNOUNCE, self._announce, pair, side)

    def _answer(self, now: float, pair: int, side: int, left: int) -> None:
        """To one peer, whose announcement was the first that was heard of it."""
        if self._known[pair] != _BOTH:
            self._heard(now, pair, side)
            if left > 1:
                self._at(now + ANSWER, self._answer, pair, side, left - 1)

    def _heard(self, now: float, pair: int, side: int) -> None:
        """Each hears of the other once, and answers."""
        known = self._known[pair] | 1 << side
        if known == self._known[pair] or self._random.random() < self._loss:
            return
        self._known[pair] = known
        if known == _BOTH:
            self._at(now, self._request, pair)
        else:
            self._at(now, self._answer, pair, 1 - side, ANSWERS)

    def _gave_up(self, now: float, pair: int) -> bool:
        return now - self._began[pair] > GIVE_UP + ANNOUNCE

    def _request(self, now: float, pair: int) -> None:
        if self._state[pair] & _SENT or self._gave_up(now, pair):
            return
        one, two = self._sides[pair]
        if self._arrives(now, one, two, 0) and not self._state[pair] & _ANSWERED:
            self._state[pair] |= _ANSWERED
            self._at(self._work(two, now, self._costs.responder), self._reply, pair)
        self._at(now + RESEND, self._request, pair)

    def _reply(self, now: float, pair: int) -> None:
        if self._state[pair] & _DONE or self._gave_up(now, pair):
            return
        one, two = self._sides[pair]
        if self._arrives(now, two, one, 1):
            end = now
            if not self._state[pair] & _SENT:
                self._state[pair] |= _SENT
                end = self._work(one, now, self._costs.initiator)
            self._at(end, self._final, pair)
        self._at(now + RESEND, self._reply, pair)

    def _final(self, now: float, pair: int) -> None:
        one, two = self._sides[pair]
        arrived = [self._arrives(now, one, two, 2) for _ in range(FINALS)]
        if self._state[pair] & _DONE or not any(arrived):
            return
        self._state[pair] |= _DONE
        end = max(self._settle(each, now, pair) for each in (one, two))
        late = LATE if self._random.random() < LATE_SHARE else 0.0
        self.met[pair] = end + BASE + self._random.uniform(*SETTLE) + late

    def _settle(self, participant: int, now: float, pair: int) -> float:
        """When the host of `participant` has done what the stack does for the pair, and what it
        has repeated for it meanwhile."""
        served = max(now, self._free[self._host(participant)][0])
        waited = served - self._began[pair]
        return self._work(participant, now, self._costs.stack + waited * self._costs.repeat)
