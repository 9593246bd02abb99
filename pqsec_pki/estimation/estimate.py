"""The estimate of a scenario: both models, what would help, and where they hold."""

from collections.abc import Iterator
from dataclasses import replace
from math import isfinite

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PROFILES
from pqsec_pki.estimation.closed_form import ClosedForm
from pqsec_pki.estimation.messages import sizes_of
from pqsec_pki.estimation.scenario import GIVE_UP, RESEND, Scenario
from pqsec_pki.estimation.simulation import Simulated, simulated
from pqsec_pki.handshake import MessageSizes
from pqsec_pki.stacks import IPFRAG_HIGH_THRESH, SMALL_FRAGMENT

TIMES = (1, 2, 5, 10, 30, 60)
"""Seconds after which the share of pairs that have not met is given."""
_SLOWER = 1.1
_WORTH = 0.8
"""Advice must bring the median below this part of it."""
VALIDITY = (
    "valid for Cyclone DDS's timers, participants that all meet each other, and frames lost"
    " independently of each other; not for losses in bursts, networks without capacity for the"
    " bytes, or hosts with other work. Compared with real meshes of 2 to 40 participants on one"
    " machine: see bench/README.md"
)


@dataclass(frozen=True)
class Advice:
    """A change, and the median time to a full mesh with it."""

    change: str
    median: float | None
    """Seconds; None if the change is not made for the time."""


@dataclass(frozen=True)
class Estimate:
    """What is expected of a scenario."""

    scenario: Scenario
    closed: ClosedForm
    simulation: Simulated
    second: MessageSizes | None = None
    """The sizes in the second version of the messages, if it is another one and there is one."""

    @property
    def notes(self) -> Iterator[str]:
        """The limits of the models in this scenario."""
        if self.scenario.overflows:
            yield (
                f"incomplete datagrams may need {self.scenario.in_reassembly} bytes in a host, over"
                f" its {self.scenario.threshold}: the closed form leaves that out, so look at the"
                " simulation"
            )
        busy = self.scenario.busy
        if busy > RESEND:
            slower = replace(self.scenario, costs=self.scenario.costs.times(_SLOWER)).busy
            yield (
                f"each host computes for {busy:.1f} s, on processors a tenth slower {slower:.1f} s:"
                " stacks repeat messages meanwhile"
            )
        if busy > GIVE_UP or not isfinite(self.simulation.pairs[-1]):
            yield f"some handshakes take longer than {GIVE_UP:.0f} s, and Cyclone DDS gives up"
        if self.simulation.participants < self.scenario.participants:
            yield (
                f"the simulation has {self.simulation.participants} participants with the work of"
                f" {self.scenario.participants}: its time of the last pair is too short"
            )

    @property
    def advice(self) -> Iterator[Advice]:
        """Changes that would help, each alone."""
        yield from self._for_datagrams()
        yield from self._for_processors()
        yield from self._for_losses()

    def _for_datagrams(self) -> Iterator[Advice]:
        scenario = self.scenario
        if max(scenario.datagrams(scenario.sizes.reply)) > 1:
            words = (
                f"send at most {SMALL_FRAGMENT} bytes in a datagram, as `pqsec export` writes it"
            )
            yield Advice(f"{words}: no datagram is then fragmented by IP", None)
        if scenario.overflows:
            need = -(-scenario.in_reassembly // IPFRAG_HIGH_THRESH) * IPFRAG_HIGH_THRESH
            yield Advice(f"or set net.ipv4.ipfrag_high_thresh={need} on each host", None)

    def _for_processors(self) -> Iterator[Advice]:
        scenario, busy = self.scenario, sum(self.scenario.work)
        if busy <= max(RESEND, scenario.start_within):
            return
        words = f"start the participants over {busy * 1.2:.0f} s: no message is then repeated"
        changed = replace(scenario, start_within=busy * 1.2)
        yield from self._if_faster(f"{words} only because hosts are busy", changed)
        changed = replace(scenario, cores=2 * scenario.cores)
        yield from self._if_faster(f"give each host {changed.cores} cores", changed)

    def _for_losses(self) -> Iterator[Advice]:
        scenario = self.scenario
        if scenario.loss and self.second:
            words = "messages of version 2 (wire_versions = [2, 1] in pqsec.toml)"
            costs = scenario.costs.in_second_version
            changed = replace(scenario, sizes=self.second, each=(), costs=costs)
            yield from self._if_faster(words, changed)
        for profile in PROFILES if scenario.loss else ():
            changed = replace(scenario, sizes=sizes_of(profile), each=())
            if changed.sizes.reply < scenario.sizes.reply * _WORTH:
                yield from self._if_faster(f"profile {profile.name}", changed)

    def _if_faster(self, words: str, changed: Scenario) -> Iterator[Advice]:
        before, after = self.closed.mesh(0.5), ClosedForm.of(changed).mesh(0.5)
        if after is not None and (before is None or after < before * _WORTH):
            yield Advice(words, after)

    def to_json(self) -> dict[str, object]:
        """The estimate for --json."""
        simulation = self.simulation
        return {
            **self.scenario.to_json(),
            "closed_form": _times(self.closed, digits=9),
            "simulation": {
                "runs": simulation.runs,
                "participants": simulation.participants,
                "events": simulation.events,
                **_times(simulation, digits=6),
            },
            "reassembly_bytes": self.scenario.in_reassembly,
            "advice": list(self.advice),
            "notes": list(self.notes),
            "validity": VALIDITY,
        }


def estimated(scenario: Scenario, seed: int, second: MessageSizes | None = None) -> Estimate:
    """The estimate by both models; the same for the same seed."""
    return Estimate(scenario, ClosedForm.of(scenario), simulated(scenario, seed), second)


def _times(model: ClosedForm | Simulated, digits: int) -> dict[str, object]:
    """The times of a model, for --json; shares of pairs have `digits` digits."""
    return {
        "mesh_median_s": _rounded(model.mesh(0.5)),
        "mesh_p95_s": _rounded(model.mesh(0.95)),
        "pair_median_s": _rounded(model.pair(0.5)),
        "apart": {str(each): round(model.apart(each), digits) for each in TIMES},
    }


def _rounded(seconds: float | None) -> float | None:
    return round(seconds, 2) if seconds is not None and isfinite(seconds) else None
