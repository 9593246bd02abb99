"""Processor time of a handshake and of what a stack does around it."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake import WireVersion

STACK_MS = 9.0
"""Milliseconds of each side for each pair: discovery, permissions, tokens and endpoints, in Cyclone
DDS 0.10.2 and the agent. Fitted to bench/calibration.csv, as the two that follow."""
REPEAT_MS = 2.4
"""Milliseconds of each side, for each second until a pair has met: Cyclone DDS repeats messages and
heartbeats to all who are not matched, about 70 datagrams a second for each pair."""
START_MS = 25.0
"""Milliseconds of each participant: its creation in the stack and in the agent."""
SECOND_MS = 0.4
"""Milliseconds of each side, to inflate and parse the peer's documents in the second version of the
messages: 0.35 to 0.41 with one key, 0.61 with `transition`. Lower quartiles of 500 handshakes of
each in turn, without the tries of ML-DSA's signatures; processor time, on a machine with other
work."""
_MOST_MS = 1e6
"""Milliseconds of a side of one handshake: ten times as long as Cyclone DDS waits for a
handshake."""
STORED = "stored: one core of an AMD EPYC, 2026-11, medians of 20; other machines: --costs"
_STORED = {
    "classical": (0.84, 0.84),
    "transition": (2.98, 2.52),
    "hybrid": (2.74, 2.72),
    "pq": (2.56, 2.04),
    "cnsa2": (2.82, 2.96),
}
"""Profile -> milliseconds of the initiator and of the responder."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Milliseconds of one core."""

    initiator: float
    responder: float
    source: str
    stack: float = STACK_MS
    """Milliseconds of each side of a pair, without the handshake."""
    repeat: float = REPEAT_MS
    """Milliseconds of each side of a pair, for each second that it waits."""
    start: float = START_MS
    """Milliseconds of each participant, once."""

    @property
    def in_second_version(self) -> "Costs":
        """The costs of handshakes with messages of the second version."""
        initiator, responder = self.initiator + SECOND_MS, self.responder + SECOND_MS
        return replace(self, initiator=initiator, responder=responder)

    def times(self, factor: float) -> "Costs":
        """All of them `factor` times as long."""
        values = (self.initiator, self.responder, self.stack, self.repeat, self.start)
        initiator, responder, *others = (factor * each for each in values)
        return Costs(initiator, responder, self.source, *others)


def costs_of(profile: str, version: WireVersion = WireVersion.FIRST) -> Costs:
    """The stored costs of a profile, measured on one machine."""
    found = Costs(*_STORED[profile], source=STORED)
    return found.in_second_version if version is WireVersion.SECOND else found


def read_costs(path: Path, profile: str, version: WireVersion = WireVersion.FIRST) -> Costs:
    """The medians of that profile in the JSON of `pqsec bench`; MalformedError without them."""
    wanted = profile, version.value
    try:
        found = json.loads(read(path))
        suite = next(
            each for each in found["suites"] if (each["profile"], each["wire_version"]) == wanted
        )
        initiator, responder = (
            _median(suite["cpu_ms"], side) for side in ("initiator", "responder")
        )
    except (
        ValueError,
        TypeError,
        KeyError,
        OverflowError,
        StopIteration,
        RecursionError,
    ) as error:
        raise MalformedError(
            f"not the JSON of `pqsec bench` with profile {profile} and messages of version"
            f" {version}",
            where=path,
            hint=f"make it with `pqsec bench --json --profile {profile} --wire-version {version}`",
        ) from error
    return Costs(initiator, responder, source=f"measured: {path}")


def _median(times: Mapping[str, Any], side: str) -> float:
    value = float(times[side]["p50"])
    if not 0 <= value <= _MOST_MS:
        raise ValueError(side)
    return value
