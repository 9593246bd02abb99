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
from pqsec_pki.stacks import IPFRAG_HIGH_THRESH

TIMES = (1, 2, 5, 10, 30, 60)
"""Seconds for which the share of pairs apart is told."""
SMALL_FRAGMENT = 1300
"""Bytes: fits into an Ethernet frame with all headers; what `pqsec export` writes."""
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

    @property
    def notes(self) -> Iterator[str]:
        """Where the models stop, in this scenario."""
        if self.scenario.overflows:
            yield (
                f"incomplete datagrams may need {self.scenario.in_reassembly} bytes in a host, over"
                f" its {self.scenario.threshold}: the closed form leaves that out, so look at the"
                " simulation"
            )
        busy = self.scenario.busy
        if busy > RESEND:
            yield f"each host computes for {busy:.1f} s: stacks repeat messages meanwhile"
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
        scenario = self.scenario
        if max(scenario.datagrams(scenario.sizes.reply)) > 1:
            words = (
                f"send at most {SMALL_FRAGMENT} bytes in a datagram, as `pqsec export` writes it"
            )
            yield Advice(f"{words}: no datagram is then fragmented by IP", None)
        if scenario.overflows:
            need = -(-scenario.in_reassembly // IPFRAG_HIGH_THRESH) * IPFRAG_HIGH_THRESH
            yield Advice(f"or set net.ipv4.ipfrag_high_thresh={need} on each host", None)
        busy = sum(scenario.seconds)
        if busy > max(RESEND, scenario.start_within):
            words = f"start the participants over {busy * 1.2:.0f} s: no message is then repeated"
            changed = replace(scenario, start_within=busy * 1.2)
            yield Advice(f"{words} only because hosts are busy", ClosedForm.of(changed).mesh(0.5))
            changed = replace(scenario, cores=2 * scenario.cores)
            yield from self._if_faster(f"give each host {changed.cores} cores", changed)
        if scenario.loss:
            for profile in PROFILES:
                sizes = sizes_of(profile)
                changed = replace(scenario, sizes=sizes, each=())
                if sizes.reply < scenario.sizes.reply * _WORTH:
                    yield from self._if_faster(f"profile {profile.name}", changed)

    def _if_faster(self, words: str, changed: Scenario) -> Iterator[Advice]:
        before, after = self.closed.mesh(0.5), ClosedForm.of(changed).mesh(0.5)
        if after is not None and (before is None or after < before * _WORTH):
            yield Advice(words, after)

    def to_json(self) -> dict[str, object]:
        """For --json."""
        scenario, closed, simulation = self.scenario, self.closed, self.simulation
        frames = {
            name: sum(scenario.datagrams(getattr(scenario.sizes, name)))
            for name in ("request", "reply", "final")
        }
        times = simulation.pairs
        return {
            "participants": scenario.participants,
            "hosts": scenario.machines,
            "cores": scenario.cores,
            "loss": scenario.loss,
            "fragment_bytes": scenario.fragment,
            "start_within_s": scenario.start_within,
            "sample_bytes": scenario.sizes,
            "frames": frames,
            "handshakes": scenario.pairs,
            "bytes": round(scenario.bytes),
            "cpu_s": round(scenario.busy * scenario.machines * scenario.cores, 3),
            "busy_s": round(scenario.busy, 3),
            "costs": scenario.costs,
            "closed_form": {
                "mesh_median_s": _rounded(closed.mesh(0.5)),
                "mesh_p95_s": _rounded(closed.mesh(0.95)),
                "pair_median_s": _rounded(closed.pair(0.5)),
                "apart": {str(each): round(closed.apart(each), 9) for each in TIMES},
            },
            "simulation": {
                "runs": simulation.runs,
                "participants": simulation.participants,
                "events": simulation.events,
                "mesh_median_s": _rounded(simulation.mesh(0.5)),
                "mesh_p95_s": _rounded(simulation.mesh(0.95)),
                "pair_median_s": _rounded(simulation.pair(0.5)),
                "apart": {
                    str(time): round(sum(each > time for each in times) / len(times), 6)
                    for time in TIMES
                },
            },
            "reassembly_bytes": scenario.in_reassembly,
            "advice": list(self.advice),
            "notes": list(self.notes),
            "validity": VALIDITY,
        }


def estimated(scenario: Scenario, seed: int) -> Estimate:
    """By both models; the same for the same seed."""
    return Estimate(scenario, ClosedForm.of(scenario), simulated(scenario, seed))


def _rounded(seconds: float | None) -> float | None:
    return round(seconds, 2) if seconds is not None and isfinite(seconds) else None
