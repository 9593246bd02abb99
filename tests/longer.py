"""What the gate tests in part, and the longer job (`.ci/long`, PQSEC_LONG=1) as a whole."""

import os

LONG = os.environ.get("PQSEC_LONG") == "1"
PART = 5
"""The gate takes one in so many."""


def examples(whole: int) -> int:
    """How many generated examples a property is tested with."""
    return whole if LONG else max(whole // PART, 20)


def seeds(whole: int, gate: int) -> range:
    """The seeds below `whole`; in the gate `gate` of them, spread evenly."""
    return range(0, whole, 1 if LONG else whole // gate)
