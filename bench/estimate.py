"""`pqsec estimate` against real runs: mesh.csv, and the pairs and hosts of examples/study.

A measured median of few runs differs from the true one. So beside what the simulation tells
stands how far the median of as many runs lies from it, if the simulation were right: the range of
95 % of such medians, and how often they are within 20 %. A median outside the range shows that
the model misses something. Times are seconds until the last host had met all others; a run that did
not end is later than all others.
Run: python bench/estimate.py
"""

import csv
import gzip
import statistics
from collections import defaultdict
from collections.abc import Iterator
from itertools import chain
from math import isfinite
from pathlib import Path
from random import Random
from typing import NamedTuple

from pqsec_pki.algorithms import profile_named
from pqsec_pki.estimation import Scenario, costs_of, simulated, sizes_of
from pqsec_pki.handshake import WireVersion

HERE = Path(__file__).parent
STUDY = HERE.parent / "examples/study/results"
PARTS = ("pairs", "versions", "hosts")
RUNS, DRAWS = 200, 4000
NEAR = 0.2
Cell = tuple[str, WireVersion, int, float]
"""Where it was measured, of which messages, hosts, and the share of frames that were lost."""


class Compared(NamedTuple):
    seen: float
    told: float
    low: float
    high: float
    chance: float
    """That a median of as many runs is within NEAR, if the model is right."""

    def __str__(self) -> str:
        medians = f"{self.low:5.2f} to {self.high:5.2f}, {self.chance:4.0%} within 20 %"
        return f"{self.seen:6.2f} {self.told:6.2f}  {medians}: {self.verdict}"

    @property
    def verdict(self) -> str:
        if isfinite(self.seen) and abs(self.told - self.seen) <= NEAR * self.seen:
            return "within 20 %"
        return "in the range" if self.low <= self.seen <= self.high else "OUTSIDE"


def main() -> None:
    print(__doc__.split("Run:")[0])
    head = f"{'of':<6} version {'hosts':>5} {'loss':>5} {'runs':>4} {'seen':>6} {'told':>6}"
    print(f"{head}  range of medians")
    cells = defaultdict[Cell, list[float]](list)
    for cell, time in (*from_mesh(), *chain.from_iterable(map(from_study, PARTS))):
        cells[cell].append(time)
    for (source, version, hosts, loss), times in sorted(cells.items()):
        found = compared(version, hosts, loss, times)
        print(
            f"{source:<6} {version:>7} {hosts:>5} {loss:>5.0%} {len(times):>4} {found}", flush=True
        )


def from_mesh() -> Iterator[tuple[Cell, float]]:
    with (HERE / "mesh.csv").open() as file:
        for row in csv.DictReader(file):
            met = row["complete"] == row["hosts"]
            cell = "mesh", WireVersion.FIRST, int(row["hosts"]), float(row["loss_percent"]) / 100
            yield cell, float(row["last_s"]) if met else float("inf")


def from_study(part: str) -> Iterator[tuple[Cell, float]]:
    """Hosts with networks of their own, profile pq, MTU 1500."""
    with gzip.open(STUDY / f"{part}-cyclonedds.csv.gz", "rt") as file:
        for row in csv.DictReader(file):
            kind = row["plugins"], row["profile"], row["mtu"], row["measure"]
            if kind == ("pqsec", "pq", "1500", "full_s"):
                cell = (
                    "study",
                    WireVersion(int(row["wire_version"])),
                    int(row["hosts"]),
                    float(row["loss"]),
                )
                yield cell, float(row["value"] or "inf")


def compared(version: WireVersion, hosts: int, loss: float, times: list[float]) -> Compared:
    """All hosts shared two cores."""
    profile = profile_named("pq")
    asked = Scenario(
        participants=hosts,
        sizes=sizes_of(profile, version),
        costs=costs_of(profile.name, version),
        loss=loss,
        hosts=1,
        cores=2,
    )
    meshes = simulated(asked, seed=1, most=RUNS * asked.pairs).meshes
    random, told = Random(1), statistics.median(meshes)  # noqa: S311 -- no secret
    drawn = sorted(statistics.median(random.choices(meshes, k=len(times))) for _ in range(DRAWS))
    near = sum(abs(told - each) <= NEAR * each for each in drawn) / DRAWS
    low, high = drawn[DRAWS // 40], drawn[-DRAWS // 40]
    return Compared(statistics.median(times), told, low, high, near)


if __name__ == "__main__":
    main()
