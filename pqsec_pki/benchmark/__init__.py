"""Measure the authentication handshake: time of each operation, sizes of the messages, memory.

    suites         which keys and key agreements are measured together
    participants   a CA and two participants in memory
    measuring      rounds of a handshake, each operation timed
    results        samples, percentiles and sizes of one suite
    environment    what the numbers depend on: versions, processor, load

In memory and without a DDS stack: what is measured is what the Authentication plugin does.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.benchmark.environment import Environment
    from pqsec_pki.benchmark.measuring import measured_rounds
    from pqsec_pki.benchmark.participants import MeasuredParticipants
    from pqsec_pki.benchmark.results import (
        CSV_COLUMNS,
        HandshakeSizes,
        MeasuredSuite,
        Operation,
        Timing,
        percentile,
    )
    from pqsec_pki.benchmark.suites import HandshakeSuite, every_suite, suites_of
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CSV_COLUMNS",
    "Environment",
    "HandshakeSizes",
    "HandshakeSuite",
    "MeasuredParticipants",
    "MeasuredSuite",
    "Operation",
    "Timing",
    "every_suite",
    "measured_rounds",
    "percentile",
    "suites_of",
]
