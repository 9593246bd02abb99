"""Writes unmeasured.txt: tests whose coverage the gate does not measure, since others show it.

Measuring makes a test take half as long again. A new file is measured, and a new test in a file
that is not named as a whole. Write the list again when the gate's coverage has fallen, or its time
has grown, from a run of .ci/run with these options of pytest in `tests` (elsewhere tests are
skipped, and what shows nothing is named):

    --cov --cov-context=test --cov-report= --junitxml=FILE

Then, in that checkout: .venv-test/bin/python -m tests.unmeasured .coverage FILE
"""

import sys
from collections import defaultdict
from collections.abc import Iterable
from contextlib import closing
from heapq import heapify, heappop, heappush
from pathlib import Path
from sqlite3 import connect
from xml.etree import ElementTree as ET

from tests.measured import LIST

QUICK = 0.1
"""Seconds, of all cases of a test: quicker ones are not named alone."""
WORTH = 10
"""Points that a test adds for each second that it takes: with fewer it is not measured."""

Point = tuple[int, ...]
"""A file and a line of it; or a file, a line that others may follow, and the one that did."""


def worth_measuring(seconds: dict[str, float], points: dict[str, set[Point]]) -> set[str]:
    """Tests that together show what all show, except points that take too long.

    The next one is always that which adds most points in a second.
    """
    waiting = [(-len(found) / seconds[test], test) for test, found in points.items()]
    heapify(waiting)
    shown = set[Point]()
    chosen = set()
    while waiting:
        _, test = heappop(waiting)
        rate = len(points[test] - shown) / seconds[test]
        if waiting and rate < -waiting[0][0]:  # others have shown some of its points
            heappush(waiting, (-rate, test))
        elif rate < WORTH:
            break
        else:
            chosen.add(test)
            shown |= points[test]
    return chosen


def unmeasured(seconds: dict[str, float], chosen: set[str]) -> list[str]:
    """The others: a file if none of its tests is chosen, else its tests that are not quick."""
    files = {_file(test) for test in chosen}
    return sorted(
        {_file(test) for test in seconds}.difference(files)
        | {
            test
            for test in seconds.keys() - chosen
            if _file(test) in files and seconds[test] >= QUICK
        }
    )


def _file(test: str) -> str:
    return test.partition("::")[0]


def _seconds(junit: Path) -> dict[str, float]:
    found = defaultdict[str, float](float)
    for case in ET.parse(junit).iter("testcase"):  # noqa: S314 -- pytest wrote it
        file = Path(case.attrib["classname"].replace(".", "/") + ".py")
        name = case.attrib["name"].partition("[")[0]
        if file.is_file():  # else a test of a class
            found[f"{file}::{name}"] += max(float(case.attrib["time"]), 0.001)
    return found


def _points(coverage: Path) -> dict[str, set[Point]]:
    query = "select context, file_id, fromno, tono from arc join context on context.id = context_id"
    steps = defaultdict[str, set[Point]](set)
    with closing(connect(coverage)) as data:
        for context, *step in data.execute(query):
            steps[context.partition("|")[0].partition("[")[0]].add(tuple(step))
    followers = defaultdict[Point, set[int]](set)
    for file, line, follower in set().union(*steps.values()):
        followers[file, line].add(follower)

    def points(steps: Iterable[Point]) -> set[Point]:
        lines = {(file, line) for file, _, line in steps}
        return lines | {step for step in steps if len(followers[step[:2]]) > 1}

    return {test: points(found) for test, found in steps.items()}


if __name__ == "__main__":
    seconds = _seconds(Path(sys.argv[2]))
    points = _points(Path(sys.argv[1]))
    chosen = worth_measuring(seconds, {test: points[test] for test in points.keys() & seconds})
    LIST.write_text("".join(f"{test}\n" for test in unmeasured(seconds, chosen)))
