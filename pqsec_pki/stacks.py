"""The DDS stacks and ROS 2: one row each, by which every room keys what it knows about them.

A stack can be exported for, run, simulated or interpreted if the room for that has a row for it.
"""

from enum import StrEnum
from itertools import groupby
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import UsageError


class Stack(StrEnum):
    """A stack; its value is the name that a user types."""

    product: str
    """The name of the product."""

    def __new__(cls, name: str, product: str) -> Self:
        """A row of the table."""
        row = str.__new__(cls, name)
        row._value_ = name
        row.product = product
        return row

    CYCLONEDDS = "cyclonedds", "Cyclone DDS"
    FASTDDS = "fastdds", "Fast DDS"
    OPENDDS = "opendds", "OpenDDS"
    CONNEXT = "connext", "RTI Connext"
    ROS2 = "ros2", "ROS 2"


class OtherStack(str):
    """A stack that another package adds to `pqsec export`: its name, in small letters."""

    __slots__ = ("product",)
    product: str
    """The name of the product."""

    def __new__(cls, name: str, product: str) -> Self:
        """Such as OtherStack("labdds", "Lab DDS")."""
        row = super().__new__(cls, name)
        row.product = product
        return row


def stack_named(name: str) -> Stack:
    """The stack of that name; UsageError, with all names, if there is none."""
    for stack in Stack:
        if stack == name.lower():
            return stack
    raise UsageError(f"no stack named {name!r}", hint=f"known: {', '.join(Stack)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageLimit:
    """The largest handshake message that some versions of a stack can send."""

    stack: Stack
    size: int
    """Bytes of the sample."""
    versions: tuple[tuple[int, int, int], ...]
    """The versions that have the limit, ascending."""

    def __str__(self) -> str:
        """The versions, as in `Fast DDS 2.14.4, 3.1.1 to 3.1.3 and 3.2.0`."""
        series = [list(each) for _, each in groupby(self.versions, key=lambda each: each[:2])]
        texts = [" to ".join(map(_text, dict.fromkeys((each[0], each[-1])))) for each in series]
        return f"{self.stack.product} {', '.join(texts[:-1])} and {texts[-1]}"


FAST_DDS_LIMIT = MessageLimit(
    stack=Stack.FASTDDS,
    size=8192,
    versions=(
        *((2, 14, 4), (3, 0, 2), (3, 1, 1), (3, 1, 2), (3, 1, 3)),
        *((3, 2, 0), (3, 2, 1), (3, 2, 2)),
    ),
)
"""3.1.2 was run, the others' source was read."""

DATAGRAM = 65507
"""Bytes: the largest UDP payload over IPv4, in which Fast DDS sends a message whole."""
FRAGMENT, SMALL_FRAGMENT = 1344, 1300
"""Bytes of a sample in one datagram: by default in Cyclone DDS (General/FragmentSize), and as
`pqsec export` sets it, so that the datagram fits an Ethernet frame with all headers."""
FRAME = 1480
"""Bytes of a UDP datagram in one Ethernet frame; a larger one is fragmented by IP."""
FRAME_MEMORY = 2304
"""Bytes that Linux accounts for a frame while its datagram is incomplete: assumed, and it explains
how many datagrams of 14 and 30 kB were delivered in a run."""
IPFRAG_HIGH_THRESH = 4 << 20
"""Bytes of incomplete datagrams that Linux holds for 30 s (net.ipv4.ipfrag_high_thresh)."""


def frames_of(size: int) -> int:
    """The Ethernet frames of a UDP datagram of `size` bytes."""
    return -(-size // FRAME)


def _text(version: tuple[int, int, int]) -> str:
    return ".".join(map(str, version))
