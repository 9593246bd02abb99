"""What the gate tests in part, and the longer job (`.ci/long`, PQSEC_LONG=1) as a whole."""

import os
from collections.abc import Sequence
from typing import TypeVar

Case = TypeVar("Case")

LONG = os.environ.get("PQSEC_LONG") == "1"
PART = 5
"""The gate takes one in so many."""
FEW = 3
"""And of tables that many tests go through, one row in so many."""


def examples(whole: int) -> int:
    """How many generated examples a property is tested with."""
    return whole if LONG else max(whole // PART, 20)


def seeds(whole: int, gate: int) -> range:
    """The seeds below `whole`; in the gate `gate` of them, spread evenly."""
    return range(0, whole, 1 if LONG else whole // gate)


def some(rows: Sequence[Case], turn: int = 0) -> Sequence[Case]:
    """The rows of a table for the test number `turn`; in the gate some, each time others."""
    return rows if LONG else rows[turn % FEW :: FEW]
