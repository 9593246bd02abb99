"""The evaluation: talkers and listeners in real stacks, classical to post-quantum, under loss.

Run: python study.py RESULTS [--part PART...] [--stack STACK...] [--hosts N...] [--rounds N]
[--small]

It needs pqsec with its extra `plot`, the stacks, and what `pqsec bench --stack` needs. RESULTS is a
folder: one CSV for each part and stack, to which each round is added, so a study can be continued.
Ctrl-C keeps the runs that were finished. Then summary.py makes the tables and plots.
"""

import argparse
import csv
import gzip
import json
from dataclasses import asdict, replace
from datetime import UTC, datetime
from itertools import product
from pathlib import Path

from summary import summarize

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.benchmark import (
    MESH_COLUMNS,
    Environment,
    MeasuredMeshes,
    MeshCase,
    MeshPlan,
    Plugins,
    measured_meshes,
    measured_rounds,
    suites_of,
)
from pqsec_pki.handshake import WireVersion
from pqsec_pki.trial import STACKS, Link, find

OWN = (Plugins.STOCK, "classical", None)
UNSECURED = (Plugins.NONE, None, None)
CLASSICAL, PQ, CNSA2, TRANSITION, HYBRID = (
    (Plugins.PQSEC, name, WireVersion.FIRST)
    for name in ("classical", "pq", "cnsa2", "transition", "hybrid")
)
PQ_SECOND, CNSA2_SECOND = ((Plugins.PQSEC, name, WireVersion.SECOND) for name in ("pq", "cnsa2"))
VERSIONS = (PQ, PQ_SECOND, CNSA2, CNSA2_SECOND)
MAIN = (OWN, CLASSICAL, PQ, CNSA2)
SAMPLES = 20


def case(kind, hosts, link):
    plugins, profile, version = kind
    return MeshCase(plugins=plugins, profile=profile, hosts=hosts, link=link, wire_version=version)


def cases(kinds, hosts=(2,), losses=(0.0,), mtus=(1500,)):
    return [
        case(kind, count, Link(loss=loss, mtu=mtu))
        for count, loss, mtu, kind in product(hosts, losses, mtus, kinds)
    ]


PARTS = {
    "pairs": [
        *cases(MAIN, losses=(0.0, 0.01, 0.05, 0.1)),
        *cases((UNSECURED, TRANSITION, HYBRID), losses=(0.0, 0.05)),
        *cases(MAIN, losses=(0.0, 0.05), mtus=(576,)),
    ],
    "versions": [
        *cases(VERSIONS, losses=(0.0, 0.01, 0.05, 0.1)),
        *cases(VERSIONS, losses=(0.0, 0.05), mtus=(576,)),
    ],
    "hosts": cases((OWN, PQ, PQ_SECOND), hosts=(5, 10, 20, 40), losses=(0.0, 0.05)),
}
SMALL = {
    "pairs": cases((OWN, PQ), losses=(0.0, 0.05)),
    "versions": cases((PQ, PQ_SECOND), losses=(0.0, 0.05)),
    "hosts": cases((OWN, PQ), hosts=(3, 5)),
}
WARM_UP = case(PQ, 2, Link())
"""Run before each round and not kept: the agent starts its first worker."""
ROUNDS = {"pairs": 20, "versions": 20, "hosts": 5}
TIMEOUT = {"pairs": 60.0, "versions": 60.0, "hosts": 120.0}


def measure(part, stack, matrix, rounds, folder):
    path = folder / f"{part}-{stack}.csv.gz"
    done = rounds_in(path)
    installation = find(stack)
    for number in range(done + 1, done + rounds + 1):
        now = datetime.now(UTC)
        plan = MeshPlan(
            installation=installation,
            cases=[WARM_UP, *matrix],
            rounds=1,
            timeout=TIMEOUT[part],
            samples=SAMPLES,
            now=now,
        )
        environment = Environment.here(now)
        runs = [replace(each, number=number) for each in measured_meshes(plan)[1:]]
        keep(
            path, MeasuredMeshes(stack=stack, version=installation.version, runs=runs), environment
        )
        print(f"{part}, {stack}, round {number}: {len(runs)} of {len(matrix)} runs", flush=True)
        if len(runs) < len(matrix):
            raise SystemExit(130)


def rounds_in(path):
    """How many rounds the file already has; it must have the columns of today's pqsec."""
    if not path.exists():
        return 0
    with gzip.open(path, "rt") as file:
        rows = csv.DictReader(file)
        if tuple(rows.fieldnames or ()) != MESH_COLUMNS:
            raise SystemExit(f"{path} was made by another version: use a new folder")
        return max((int(row["run"] or 0) for row in rows), default=0)


def keep(path, found, environment):
    """Add the rows; the environment only once."""
    new = not path.exists()
    with gzip.open(path, "at", newline="") as file:
        writer = csv.DictWriter(file, MESH_COLUMNS, lineterminator="\n")
        if new:
            writer.writeheader()
        for row in found.rows(environment):
            if new or not row["measure"].startswith("environment."):
                writer.writerow(row)


def suites(rounds, folder):
    """The handshake in memory, as JSON."""
    now = datetime.now(UTC)
    chosen = dict.fromkeys(
        each.in_version(version) for each in suites_of(PROFILES) for version in WireVersion
    )
    found = [measured_rounds(each, rounds=rounds, warm_up=5, now=now) for each in chosen]
    value = {
        "environment": asdict(Environment.here(now)),
        "suites": [each.to_json(1344) for each in found if each],
    }
    with gzip.open(folder / "suites.json.gz", "wt") as file:
        json.dump(value, file, default=str)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("results", type=Path, help="a folder, to which each round is added")
    parser.add_argument("--part", nargs="+", choices=["suites", *PARTS], help="[all]")
    parser.add_argument(
        "--stack", nargs="+", choices=list(map(str, STACKS)), default=list(STACKS), help="[all]"
    )
    parser.add_argument("--hosts", type=int, nargs="+", help="only cases of so many hosts [all]")
    parser.add_argument("--rounds", type=int, help="rounds of each part [20 of pairs, 5 of hosts]")
    parser.add_argument("--small", action="store_true", help="minutes instead of hours")
    words = parser.parse_args()
    words.results.mkdir(exist_ok=True)
    for part in words.part or ["suites", *PARTS]:
        if part == "suites":
            suites(10 if words.small else 200, words.results)
            continue
        matrix = (SMALL if words.small else PARTS)[part]
        matrix = [each for each in matrix if each.hosts in (words.hosts or [each.hosts])]
        rounds = words.rounds or (2 if words.small else ROUNDS[part])
        for stack in words.stack:
            measure(part, str(stack), matrix, rounds, words.results)
    text = "\n".join(summarize(words.results))
    (words.results / "tables.md").write_text(f"{text}\n")
    print(text)


if __name__ == "__main__":
    main()
