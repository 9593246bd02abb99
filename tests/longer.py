"""What the gate runs of the tests, and the longer job (`.ci/long`, PQSEC_LONG=1) as a whole.

Amounts: generated examples, seeds and the rows that one test goes through are fewer in the gate.

Cases: `chosen` has those of the gate. A test that is marked `slow` is not among them; one that is
marked `slow(but=N)` is with N of its cases. Of another test over several tables (profiles by
versions by who begins) the gate takes each value of each table once: what one value breaks is seen,
and what only two together break is left to the longer job. What is left out is deselected, and not
skipped: thousands of skips would hide those that mean something. A test that is named with `::`
always runs. PQSEC_LONG=cases runs all cases in the gate's amounts.

Parts: PQSEC_PART=2/5 runs the second of five parts of the cases.
"""

import os
from collections import defaultdict
from collections.abc import Collection, Hashable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import pytest

Case = TypeVar("Case")

LONG = os.environ.get("PQSEC_LONG") == "1"
ALL_CASES = os.environ.get("PQSEC_LONG") in {"1", "cases"}
PART, PARTS = map(int, os.environ.get("PQSEC_PART", "1/1").split("/"))
EXAMPLES = 40
"""Of generated examples, which have seeds of their own, the gate takes one in so many."""
FEW = 3
"""And of tables that many tests go through, one row in so many."""


def examples(whole: int) -> int:
    """How many generated examples a property is tested with."""
    return whole if LONG else max(whole // EXAMPLES, 8)


def seeds(whole: int, gate: int) -> range:
    """The seeds below `whole`; in the gate `gate` of them, spread evenly."""
    return range(0, whole, 1 if LONG else whole // gate)


def some(rows: Sequence[Case], turn: int = 0) -> Sequence[Case]:
    """The rows of a table for the test number `turn`; in the gate some, each time others."""
    return rows if LONG else rows[turn % FEW :: FEW]


def chosen(items: Sequence[pytest.Item], named: Collection[pytest.Item]) -> list[pytest.Item]:
    """Those that run here, in their order; `named` are among them."""
    others = [item for item in items if item not in named]
    kept = {*named, *(others if ALL_CASES else of_gate(others))[PART - 1 :: PARTS]}
    return [item for item in items if item in kept]


def of_gate(items: Iterable[pytest.Item]) -> list[pytest.Item]:
    """Those that the gate runs, test by test."""
    tests: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        tests[item.nodeid.partition("[")[0]].append(item)
    return [item for cases in tests.values() for item in _of_test(cases)]


def _of_test(cases: list[pytest.Item]) -> list[pytest.Item]:
    quick = [each for each in cases if not each.get_closest_marker("slow")]
    slow = [each for each in cases if each.get_closest_marker("slow")]
    count = slow[0].get_closest_marker("slow").kwargs.get("but", 0) if slow else 0
    return [*each_value(quick), *spread(slow, count)]


def named(items: Iterable[pytest.Item], arguments: Iterable[str], folder: Path) -> set[pytest.Item]:
    """Those that arguments of a command in that folder name with `::`."""
    wanted: dict[Path, set[str]] = defaultdict(set)
    for file, _, name in (each.partition("::") for each in arguments if "::" in each):
        wanted[Path(os.path.abspath(folder / file))].add(name)  # noqa: PTH100
    return {
        item
        for item in items
        if item.path in wanted and not wanted[item.path].isdisjoint(_names(item))
    }


def _names(item: pytest.Item) -> list[str]:
    """Of the case, of its test, and of classes around it."""
    case = item.nodeid.partition("::")[2]
    test = case.partition("[")[0].split("::")
    return [case, *("::".join(test[: number + 1]) for number in range(len(test)))]


def spread(cases: Sequence[Case], count: int) -> list[Case]:
    """So many of them, evenly."""
    count = min(count, len(cases))
    return [cases[number * len(cases) // count] for number in range(count)]


def each_value(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Cases that together have each value of each table of their test."""
    return [items[number] for number in covering([values(item) for item in items])]


def covering(cases: Sequence[Collection[Hashable]]) -> list[int]:
    """The numbers of few cases that together have all values that there are."""
    left = set(range(len(cases)))
    missing = {value for case in cases for value in case}
    chosen = [] if missing else sorted(left)
    while missing:
        best = max(sorted(left), key=lambda number: len(missing.intersection(cases[number])))
        chosen.append(best)
        left.remove(best)
        missing.difference_update(cases[best])
    return sorted(chosen)


def values(item: pytest.Item) -> list[Hashable]:
    """(names, values) of each table that a case is from: of each `parametrize` and fixture."""
    call = getattr(item, "callspec", None)
    left = dict(call.params) if call else {}
    tables = []
    for mark in item.iter_markers("parametrize"):
        names = mark.args[0].split(",") if isinstance(mark.args[0], str) else mark.args[0]
        tables.append(tuple(name.strip() for name in names))
    found = [(table, tuple(id(left.pop(name)) for name in table)) for table in tables]
    return [*found, *((name, id(value)) for name, value in left.items())]
