"""Samples of one suite, their percentiles, and the sizes of its messages."""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from statistics import fmean

from pqsec_pki._dataclass import dataclass
from pqsec_pki.benchmark.suites import HandshakeSuite

PERCENTILES = (50, 95, 99)
_MICRO = 10**6
CSV_COLUMNS = (
    *("profile", "signature", "key_agreement", "round", "side", "operation"),
    *("wall_us", "cpu_us", "wire_version"),
)


class Operation(StrEnum):
    """A function of the Authentication plugin, with the message that it takes or makes
    (DDS-Security 1.1, 8.3.2.7.3, 8.3.2.7.4 and 8.3.2.7.5)."""

    REQUEST = "begin_handshake_request"
    REPLY = "begin_handshake_reply"
    FINAL = "process_handshake (reply)"
    END = "process_handshake (final)"

    @property
    def side(self) -> str:
        """Who runs it."""
        return "initiator" if self in {Operation.REQUEST, Operation.FINAL} else "responder"


@dataclass(frozen=True, slots=True)
class Timing:
    """How long an operation took, in nanoseconds."""

    wall: int
    cpu: int
    """Processor time of the thread."""


@dataclass(frozen=True, slots=True)
class HandshakeSizes:
    """Bytes of the three messages: of a token, and of the sample that carries it."""

    tokens: tuple[int, int, int]
    samples: tuple[int, int, int]

    def fragments(self, size: int) -> tuple[int, ...]:
        """How many datagrams carry each, with `size` bytes of a sample in one."""
        return tuple(-(-sample // size) for sample in self.samples)


@dataclass(frozen=True, slots=True)
class MeasuredSuite:
    """The rounds of one suite."""

    suite: HandshakeSuite
    rounds: tuple[dict[Operation, Timing], ...]
    sizes: HandshakeSizes
    memory: int
    """Bytes: the most that Python held for one handshake, both sides; not what OpenSSL held."""

    def wall_ms(self, *operations: Operation) -> list[float]:
        """Milliseconds of each round, all operations together."""
        return [_sum(each[one].wall for one in operations) for each in self.rounds]

    def cpu_ms(self, *operations: Operation) -> list[float]:
        """Milliseconds of processor time of each round, all operations together."""
        return [_sum(each[one].cpu for one in operations) for each in self.rounds]

    def to_json(self, fragment: int) -> dict[str, object]:
        """For --json, with `fragment` bytes of a sample in one datagram."""
        parts: dict[str, tuple[Operation, ...]] = {
            "handshake": tuple(Operation),
            "initiator": tuple(each for each in Operation if each.side == "initiator"),
            "responder": tuple(each for each in Operation if each.side == "responder"),
            **{each.value: (each,) for each in Operation},
        }
        return {
            "profile": self.suite.profile,
            "signature": self.suite.keys,
            "key_agreement": self.suite.agreement.name,
            "wire_version": self.suite.version,
            "rounds": len(self.rounds),
            "wall_ms": {name: summary(self.wall_ms(*part)) for name, part in parts.items()},
            "cpu_ms": {name: summary(self.cpu_ms(*part)) for name, part in parts.items()},
            "token_bytes": self.sizes.tokens,
            "sample_bytes": self.sizes.samples,
            "fragments": self.sizes.fragments(fragment),
            "python_memory_bytes": self.memory,
            "samples": list(self.rows()),
        }

    def rows(self) -> Iterator[dict[str, object]]:
        """One for each operation of each round, with the keys CSV_COLUMNS."""
        own = (self.suite.profile, self.suite.keys, self.suite.agreement.name)
        for number, each in enumerate(self.rounds, start=1):
            for operation, timing in each.items():
                values = (
                    *(*own, number, operation.side, operation.value),
                    *(timing.wall / 1000, timing.cpu / 1000, self.suite.version),
                )
                yield dict(zip(CSV_COLUMNS, values, strict=True))


def summary(values: Sequence[float]) -> dict[str, float]:
    """The least, the mean, PERCENTILES and the most, to a microsecond if they are milliseconds."""
    found = {"min": min(values), "mean": fmean(values)}
    found |= {f"p{each}": percentile(values, each) for each in PERCENTILES}
    found["max"] = max(values)
    return {name: round(value, 3) for name, value in found.items()}


def percentile(values: Sequence[float], percent: float) -> float:
    """The value that `percent` of the values do not exceed, interpolated between neighbours.

    Definition 7 of Hyndman and Fan (1996), as numpy and R have it by default.
    """
    place = (len(values) - 1) * percent / 100
    ordered, below = sorted(values), int(place)
    above = min(below + 1, len(values) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (place - below)


def _sum(nanoseconds: Iterator[int]) -> float:
    return sum(nanoseconds) / _MICRO
