"""Tables and plots of the study's results, with confidence intervals.

Run: python summary.py RESULTS, the folder that study.py filled. It prints Markdown, and writes
plots beside the results. study.py ends with it.

Medians have intervals by order statistics, without an assumption about the distribution: of n runs,
the interval from the k-th to the (n-k+1)-th has a coverage of 1 - 2 P(B < k), B binomial with n and
1/2. The tables have the narrowest interval with at least 95 %; if the whole range has less, they
have the range with its own coverage.
"""

import argparse
import csv
import gzip
import json
from collections import defaultdict
from itertools import product
from math import comb
from pathlib import Path
from statistics import median

from pqsec_pki.benchmark import meshes_drawn, suites_drawn

LEVEL = 0.95
MANY = 3
"""Fewer values are listed, without an interval."""
STACKS = {"cyclonedds": "Cyclone DDS", "fastdds": "Fast DDS"}


def coverage(n, k):
    """Of the interval between the k-th and the k-th last of n values, for the median."""
    return 1 - 2 * sum(comb(n, each) for each in range(k)) / 2**n


def interval(values):
    """(low, high, coverage) of the median."""
    n, ordered = len(values), sorted(values)
    k = max((k for k in range(1, n // 2 + 1) if coverage(n, k) >= LEVEL), default=1)
    return ordered[k - 1], ordered[n - k], coverage(n, k) if n > 1 else 0.0


def told(values, missing=0):
    """`0.52 [0.48, 0.61]`, and how many runs did not end; these count as later than all others."""
    if not values:
        return "none" if missing else ""
    values = [*values, *[float("inf")] * missing]
    if len(values) < MANY:
        return ", ".join(map(number, values))
    low, high, share = interval(values)
    middle = median(values)
    text = f"{number(middle)} [{number(low)}, {number(high)}]"
    return text if share >= LEVEL else f"{text} ({share:.0%})"


def number(value):
    if value == float("inf"):
        return "-"
    return f"{float(f'{value:.3g}'):g}"


def read(folder, part):
    """The rows of all stacks, and (case, run) -> its measures."""
    rows, runs = [], defaultdict(dict)
    for path in sorted(folder.glob(f"{part}-*.csv.gz")):
        with gzip.open(path, "rt") as file:
            rows += csv.DictReader(file)
    for row in rows:
        if row["run"] and not row["host"]:
            kind = (row["plugins"], row["profile"], row["wire_version"])
            case = (row["stack"], kind, int(row["hosts"]), float(row["loss"]), int(row["mtu"]))
            runs[case, int(row["run"])][row["measure"]] = float(row["value"] or "nan")
    cases = defaultdict(list)
    for (case, _), measures in sorted(runs.items()):
        cases[case].append(measures)
    return rows, cases


def seconds(runs):
    """The time to full mesh of the runs that got there."""
    full = [each["full_s"] for each in runs if each["full_s"] == each["full_s"]]
    return told(full, len(runs) - len(full))


def table(head, lines):
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for line in lines:
        yield "| " + " | ".join(line) + " |"
    yield ""


def name(kind):
    plugins, profile, version = kind
    words = {"none": "unsecured", "stock": f"{profile}, the stack's own"}.get(plugins, profile)
    return f"{words}, version 2" if version == "2" else words


def of_losses(cases, stack, mtu):
    """A line for each kind of participants, a column for each loss."""
    mine = {case: runs for case, runs in cases.items() if case[0] == stack and case[4] == mtu}
    losses = sorted({case[3] for case in mine})
    kinds = sorted({case[1] for case in mine}, key=KINDS.index)
    head = ["Participants", *(f"{loss:.0%} loss" for loss in losses), "runs"]
    lines = []
    for kind in kinds:
        found = [mine.get((stack, kind, 2, loss, mtu), []) for loss in losses]
        count = max(map(len, found))
        lines.append([name(kind), *(seconds(runs) for runs in found), str(count)])
    return table(head, lines)


KINDS = [
    ("none", "", ""),
    ("stock", "classical", ""),
    *product(["pqsec"], ("classical", "transition", "hybrid", "pq", "cnsa2"), "12"),
]


def of_costs(cases):
    """What a pair costs without loss."""
    head = [
        "Stack",
        "Participants",
        "datagrams",
        "kB on the wire",
        "hosts, ms",
        "agent, ms",
        "repeats",
    ]
    lines = []
    for (stack, kind, hosts, loss, mtu), runs in sorted(cases.items(), key=order):
        if (hosts, loss, mtu) == (2, 0.0, 1500):
            lines.append(
                [
                    STACKS[stack],
                    name(kind),
                    number(median(each["datagrams"] for each in runs)),
                    number(median(each["frame_bytes"] for each in runs) / 1000),
                    number(1000 * median(each["hosts_cpu_s"] for each in runs)),
                    number(1000 * median(each["agent_cpu_s"] for each in runs)),
                    number(median(each["handshake_repeats"] for each in runs)),
                ]
            )
    return table(head, lines)


def order(item):
    stack, kind, *rest = item[0]
    return stack, KINDS.index(kind), *rest


def of_hosts(cases):
    head = [
        *("Stack", "Participants", "hosts", "loss", "full mesh, s", "complete", "processor, s"),
        *("datagrams", "handshake messages", "repeats", "samples lost"),
    ]
    lines = []
    for (stack, kind, hosts, loss, _), runs in sorted(cases.items(), key=order):
        lost = [
            each["samples_lost"] for each in runs if each["samples_lost"] == each["samples_lost"]
        ]
        lines.append(
            [
                *(STACKS[stack], name(kind), str(hosts), f"{loss:.0%}", seconds(runs)),
                " ".join(f"{each['complete']:.0f}/{hosts}" for each in runs),
                number(median(each["hosts_cpu_s"] + each["agent_cpu_s"] for each in runs)),
                number(median(each["datagrams"] for each in runs)),
                number(median(each["handshake_messages"] for each in runs)),
                number(median(each["handshake_repeats"] for each in runs)),
                " ".join(f"{each:.0f}" for each in lost),
            ]
        )
    return table(head, lines)


def of_suites(suites):
    head = ["Profile", "initiator, ms", "responder, ms", "both, p95", "messages, bytes"]
    return table(
        head,
        (
            [
                name(("pqsec", each["profile"], str(each["wire_version"]))),
                *(number(each["cpu_ms"][side]["p50"]) for side in ("initiator", "responder")),
                number(each["cpu_ms"]["handshake"]["p95"]),
                "/".join(map(str, each["token_bytes"])),
            ]
            for each in suites
        ),
    )


UNITS = (
    "Times of two and of many hosts are seconds until all hosts have met: the median of the runs,",
    "with its 95 % confidence interval; of one or two runs, their values. `-` is a run that had",
    "not ended after 60 s, with many hosts after 120 s, and `none` that no run had.",
)


def tables(folder):
    """The lines of all tables, in Markdown."""
    yield from [*UNITS, ""]
    if found := measured_suites(folder):
        yield from ["## Suites in memory", "", *of_suites(found)]
    _, pairs = read(folder, "pairs")
    for stack, mtu in sorted({(case[0], case[4]) for case in pairs}):
        yield from [f"## Two hosts, {STACKS[stack]}, MTU {mtu}", "", *of_losses(pairs, stack, mtu)]
    if pairs:
        yield from ["## Costs of two hosts", "", *of_costs(pairs)]
    _, versions = read(folder, "versions")
    for stack, mtu in sorted({(case[0], case[4]) for case in versions}):
        title = f"## Both versions of the messages, {STACKS[stack]}, MTU {mtu}"
        yield from [title, "", *of_losses(versions, stack, mtu)]
    if versions:
        title = "## Costs of two hosts with both versions of the messages"
        yield from [title, "", *of_costs(versions)]
    _, many = read(folder, "hosts")
    if many:
        yield from ["## Many hosts", "", *of_hosts(many)]
    parts = {"two hosts": pairs, "both versions": versions, "many hosts": many}
    if loads := [of_loads(words, cases) for words, cases in parts.items() if cases]:
        yield f"Load before the runs, median and highest: {'; '.join(loads)}."


def of_loads(words, cases):
    loads = [each["load"] for runs in cases.values() for each in runs]
    return f"{words} {number(median(loads))}, {number(max(loads))}"


def measured_suites(folder):
    """The suites in memory, as `pqsec bench --json` has them."""
    path = folder / "suites.json.gz"
    if not path.exists():
        return []
    with gzip.open(path, "rt") as file:
        return json.load(file)["suites"]


def summarize(folder):
    """The lines of all tables; plots are written into the folder."""
    if found := measured_suites(folder):
        draw(folder, "", suites_drawn(found))
    for part in ("pairs", "versions", "hosts"):
        rows, cases = read(folder, part)
        if cases:
            draw(folder, f"{part}-", meshes_drawn(rows))
    return tables(folder)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("results", type=Path)
    print("\n".join(summarize(parser.parse_args().results)))


def draw(folder, prefix, drawn):
    for file, content in drawn.items():
        (folder / f"{prefix}{file}").write_bytes(content)


if __name__ == "__main__":
    main()
