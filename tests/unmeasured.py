"""Writes unmeasured.txt: tests whose coverage the gate does not measure, since others show it.

Measuring makes a test take half as long again. Quick tests are measured in any case, and so is what
is new. Write the list again when the gate's coverage has fallen, or its time has grown:

    python -m pytest --cov --cov-context=test --cov-report= --junitxml=FILE
    python -m tests.unmeasured .coverage FILE
"""

import sys
from collections import defaultdict
from contextlib import closing
from pathlib import Path
from sqlite3 import connect
from xml.etree import ElementTree as ET

from tests.measured import LIST, in_measured_folder

QUICK = 0.3
"""Seconds, of all cases of a test."""
WORTH = 1
"""Steps that only this test shows, for each second that it takes: with fewer it is not measured."""

Step = tuple[int, int, int]
"""A file, and two of its lines that ran one after the other."""


def unmeasured(seconds: dict[str, float], steps: defaultdict[str, set[Step]]) -> list[str]:
    """Those of the tests whose steps quick tests, and slow ones that are worth it, show too."""
    slow = sorted(
        (test for test in seconds if seconds[test] >= QUICK),
        key=lambda test: len(steps[test]) / seconds[test],
        reverse=True,
    )
    shown = set[Step]().union(*(found for test, found in steps.items() if test not in slow))
    left_out = []
    for test in slow:
        if len(steps[test] - shown) < WORTH * seconds[test]:
            left_out.append(test)
        else:
            shown |= steps[test]
    return sorted(left_out)


def _seconds(junit: Path) -> dict[str, float]:
    found = defaultdict[str, float](float)
    for case in ET.parse(junit).iter("testcase"):  # noqa: S314 -- pytest wrote it
        file = Path(case.attrib["classname"].replace(".", "/") + ".py")
        name = case.attrib["name"].partition("[")[0]
        if file.is_file() and in_measured_folder(file):  # else a test of a class
            found[f"{file}::{name}"] += float(case.attrib["time"])
    return found


def _steps(coverage: Path) -> defaultdict[str, set[Step]]:
    query = "select context, file_id, fromno, tono from arc join context on context.id = context_id"
    found = defaultdict[str, set[Step]](set)
    with closing(connect(coverage)) as data:
        for context, *step in data.execute(query):
            test = context.partition("|")[0].partition("[")[0]
            if in_measured_folder(Path(test.partition("::")[0])):
                found[test].add(tuple(step))
    return found


if __name__ == "__main__":
    tests = unmeasured(_seconds(Path(sys.argv[2])), _steps(Path(sys.argv[1])))
    LIST.write_text("".join(f"{test}\n" for test in tests))
