"""What the gate tests in part, and the longer job (`.ci/long`, PQSEC_LONG=1) as a whole.

Amounts: generated examples, seeds and the rows that one test goes through are fewer in the gate.

Cases: `gate_part` chooses those that the gate runs. Of a test over several tables (profiles by
versions by who begins) it takes each value of each table once: what one value breaks is seen, and
what only two together break is left to the longer job. `longer.toml` says what else it leaves out,
in one place, so that one reader sees all of it. What is left out is deselected, and not skipped:
thousands of skips would hide those that mean something. A test that is named with `::` always
runs. PQSEC_LONG=cases runs all cases in the gate's amounts.
"""

import os
import tomllib
from collections import defaultdict
from collections.abc import Collection, Hashable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import pytest

Case = TypeVar("Case")

LONG = os.environ.get("PQSEC_LONG") == "1"
ALL_CASES = os.environ.get("PQSEC_LONG") in {"1", "cases"}
TESTS = Path(__file__).parent
PART = 10
"""The gate takes one in so many."""
EXAMPLES = 40
"""Of generated examples, which have seeds of their own, one in so many."""
FEW = 3
"""And of tables that many tests go through, one row in so many."""

Part = int | list[str]
"""How many cases the gate keeps; or which it leaves out."""


def examples(whole: int) -> int:
    """How many generated examples a property is tested with."""
    return whole if LONG else max(whole // EXAMPLES, 8)


def seeds(whole: int, gate: int) -> range:
    """The seeds below `whole`; in the gate `gate` of them, spread evenly."""
    return range(0, whole, 1 if LONG else whole // gate)


def some(rows: Sequence[Case], turn: int = 0) -> Sequence[Case]:
    """The rows of a table for the test number `turn`; in the gate some, each time others."""
    return rows if LONG else rows[turn % FEW :: FEW]


def named(items: Iterable[pytest.Item], arguments: Iterable[str], folder: Path) -> set[pytest.Item]:
    """Those that arguments of a command in that folder name with `::`."""
    pairs = [each.partition("::")[::2] for each in arguments if "::" in each]
    wanted = [(Path(os.path.abspath(folder / file)), name) for file, name in pairs]  # noqa: PTH100
    return {
        item
        for item in items
        for path, name in wanted
        if item.path == path
        and f"{item.nodeid}[".partition("::")[2].startswith((f"{name}[", f"{name}::"))
    }


def gate_part(items: Iterable[pytest.Item]) -> set[pytest.Item]:
    """Those that the gate runs; UsageError if `longer.toml` leaves out a case that there is not."""
    parts = tomllib.loads((TESTS / "longer.toml").read_text())
    tests: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        tests[item.nodeid.partition("[")[0]].append(item)
    kept: set[pytest.Item] = set()
    for test, cases in tests.items():
        file, _, name = test.removeprefix("tests/").partition("::")
        part = parts.get(file, {}).get(name)
        kept.update(each_value(cases) if part is None else _part(test, cases, part))
    return kept


def _part(test: str, cases: list[pytest.Item], part: Part) -> list[pytest.Item]:
    if isinstance(part, int):
        return spread(cases, part)
    ids = {item.nodeid.partition("[")[2][:-1]: item for item in cases}
    if unknown := set(part) - set(ids):
        raise pytest.UsageError(f"tests/longer.toml: {test} has no case {sorted(unknown)}")
    return [item for name, item in ids.items() if name not in part]


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
