"""Times of a fleet by distributions: no events, and the same work for any number of participants.

A pair has met when both its processors had time for it, and after discovery and rounds of one
second until both Request and Reply with Final came through. Pairs are taken as independent, and
those that wait for a repetition leave the processors to the others.
"""

from collections.abc import Callable, Iterator
from itertools import accumulate
from math import exp, log1p

from pqsec_pki._dataclass import dataclass
from pqsec_pki.estimation.scenario import (
    ANNOUNCE,
    ANSWER,
    BASE,
    LATE,
    LATE_SHARE,
    RESEND,
    SETTLE,
    Scenario,
)

STEP = 0.1
"""Seconds of the grid."""
HORIZON = 600.0
"""Seconds: longer times are not computed."""
_BINS = int(HORIZON / STEP)
_TURNS = 64
"""Pairs of a fleet, evenly spread in the order in which the processors reach them."""


@dataclass(frozen=True)
class ClosedForm:
    """The distribution of the time at which a pair has met."""

    pairs: int
    turns: tuple[tuple[float, float], ...]
    """For each pair, in the order of the processors: its start, and the time at which they are
    free."""
    delays: tuple[float, ...]
    """delays[n]: the share of pairs that lose more than n * STEP seconds to losses."""

    @classmethod
    def of(cls, scenario: Scenario) -> "ClosedForm":
        """The closed form for the mean sizes, with enough memory for reassembly."""
        spent = [1 - each for each in accumulate(_delays(scenario))]
        delays = tuple(max(each, 0.0) for each in spent)
        prompt = 1 - delays[min(int(sum(scenario.work) / STEP), _BINS - 1)]
        return cls(scenario.pairs, tuple(_turns(scenario, prompt)), delays)

    def apart(self, time: float) -> float:
        """The share of pairs that have not met `time` seconds after the first start."""
        return sum(share * self._apart(time - BASE - wait) for wait, share in _settling())

    def _apart(self, since: float) -> float:
        """The share of pairs whose handshake or whose processors need longer."""
        late = (1.0 if since < busy else self._late(since - start) for start, busy in self.turns)
        return sum(late) / len(self.turns)

    def pair(self, share: float) -> float | None:
        """Seconds until that share of the pairs has met; None beyond HORIZON."""
        return self._first(lambda time: 1 - self.apart(time) >= share)

    def mesh(self, probability: float) -> float | None:
        """Seconds until all pairs have met with that probability; None beyond HORIZON."""

        def met(time: float) -> bool:
            apart = self.apart(time)
            return apart < 1 and exp(self.pairs * log1p(-apart)) >= probability

        return self._first(met)

    def _late(self, time: float) -> float:
        if time < 0:
            return 1.0
        return self.delays[min(int(time / STEP + 1e-9), _BINS - 1)]

    @staticmethod
    def _first(holds: Callable[[float], bool]) -> float | None:
        low, high = 0.0, HORIZON
        if not holds(high):
            return None
        while high - low > STEP / 20:
            middle = (low + high) / 2
            low, high = (low, middle) if holds(middle) else (middle, high)
        return high


def _turns(scenario: Scenario, prompt: float) -> Iterator[tuple[float, float]]:
    """Start and turn of each of _TURNS pairs, without losses.

    Two of a pair have started at t with probability (t / start_within)^2. `prompt` is the share of
    pairs that the processors meet while they are busy. If a host has more work than time, its
    handshakes are done before it turns to what the stack does for each pair.
    """
    costs = scenario.costs
    alone = (costs.initiator + costs.responder + costs.stack) / 1000
    is_busy = prompt * sum(scenario.work) > scenario.start_within
    for each in range(_TURNS):
        place = (each + 1) / _TURNS
        start = scenario.start_within * place**0.5
        yield start + alone, prompt * scenario.served(prompt * place) if is_busy else 0.0


def _delays(scenario: Scenario) -> list[float]:
    """The probability of each delay by losses, in steps."""
    request, reply, final = scenario.deliveries
    found = _discovery(1 - scenario.loss, together=scenario.start_within == 0)
    for success in (request, reply * final):
        found = _repeated(found, success, RESEND)
    return found


def _settling() -> Iterator[tuple[float, float]]:
    """Seconds after its handshake until a pair has met, each with its share of the pairs."""
    first, last = (round(each / STEP) for each in SETTLE)
    even = 0.5 / (last - first)
    for late, part in ((0.0, 1 - LATE_SHARE), (LATE, LATE_SHARE)):
        for each in range(first, last + 1):
            yield late + each * STEP, part * even * (1 + (first < each < last))


def _discovery(arrives: float, *, together: bool) -> list[float]:
    """At once if an announcement arrives, of one or of both that start together; else it is the
    next one that arrives. Who hears the first answers until an answer arrives."""
    width, found = int(ANNOUNCE / STEP), [0.0] * _BINS
    if together:
        found[0] = 1.0
        at_once = 1 - (1 - arrives) ** 2
        found = _repeated(found, at_once, ANNOUNCE)
        answered = arrives * arrives / at_once  # both were heard: neither waits for the answer
        return _answered(found, answered + (1 - answered) * arrives, arrives)
    found[:width] = [(1 - arrives) / width] * width
    found = _repeated(found, arrives, ANNOUNCE)
    found[0] += arrives
    return _answered(found, arrives, arrives)


def _answered(found: list[float], first: float, arrives: float) -> list[float]:
    """`found`, later until an answer arrives: the first one, or one a second later."""
    again = _repeated(found, arrives, ANSWER)
    back = round(ANSWER / STEP)
    return [
        first * each + (1 - first) * (again[index - back] if index >= back else 0)
        for index, each in enumerate(found)
    ]


def _repeated(found: list[float], success: float, period: float) -> list[float]:
    """`found`, later by one period for each try that fails."""
    back, made = round(period / STEP), list[float]()
    for index, each in enumerate(found):
        made.append(success * each + (1 - success) * (made[index - back] if index >= back else 0))
    return made
