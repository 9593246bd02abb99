"""What is asked: a fleet, its machines and its network; and the timers of Cyclone DDS.

The timers are read in Cyclone DDS's source, in its handshake and discovery, of one version each;
bench/README.md has an observation of 0.10.2 that announcements were repeated after 30 s only.
"""

from dataclasses import dataclass
from functools import cached_property

from pqsec_pki.estimation.costs import Costs
from pqsec_pki.handshake import MessageSizes
from pqsec_pki.stacks import FRAME, FRAME_MEMORY, IPFRAG_HIGH_THRESH

RESEND = 1.0
"""Seconds until a Request or Reply without an answer is sent again."""
ANNOUNCE = 8.0
"""Seconds between announcements of a participant, with the default lease of 10 s."""
BASE = 0.11
"""Seconds that each pair waits in any case: 10 ms before the handshake, 100 ms after it."""
GIVE_UP = 100.0
"""Seconds after which a handshake ends without success."""
REASSEMBLY = 30.0
"""Seconds for which it holds them (net.ipv4.ipfrag_time)."""
HEADERS = 92
"""Bytes of UDP, RTPS and DATA_FRAG around a fragment."""
_MILLI = 1000
_LEAST = 1e-12
"""A probability below which nothing arrives; its inverse is still a number."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Participants that start together and all meet each other."""

    participants: int
    """At least 2."""
    sizes: MessageSizes
    """The mean of all, if they differ."""
    costs: Costs
    each: tuple[MessageSizes, ...] = ()
    """Of each participant, if they differ."""
    loss: float = 0.0
    """The share of frames that get lost, 0 <= loss < 1."""
    fragment: int = 1300
    """Bytes of a sample in one datagram."""
    cores: int = 4
    """Of each host."""
    hosts: int = 0
    """How many hosts share the participants evenly; 0 means one for each participant."""
    start_within: float = 0.0
    """Seconds over which the participants start, evenly."""
    threshold: int = IPFRAG_HIGH_THRESH
    """Bytes: net.ipv4.ipfrag_high_thresh of each host."""

    @property
    def machines(self) -> int:
        """How many hosts there are."""
        return min(self.hosts or self.participants, self.participants)

    @property
    def pairs(self) -> int:
        """How many handshakes a full mesh takes."""
        return self.participants * (self.participants - 1) // 2

    def datagrams(self, size: int) -> list[int]:
        """The frames of each datagram that carries a sample of `size` bytes."""
        whole, rest = divmod(size, self.fragment)
        parts = [self.fragment] * whole + [rest] * (rest > 0)
        return [-(-(part + HEADERS) // FRAME) for part in parts]

    def delivery(self, size: int) -> float:
        """The probability that all frames of a sample arrive, if there is memory for them."""
        return max((1 - self.loss) ** sum(self.datagrams(size)), _LEAST)

    @cached_property
    def deliveries(self) -> tuple[float, float, float]:
        """Of Request, Reply and Final."""
        sizes, of = self.sizes, self.delivery
        return of(sizes.request), of(sizes.reply), of(sizes.final)

    @property
    def sent(self) -> tuple[float, float, float]:
        """How often each message of a pair is sent, on average.

        A Request is repeated until the Reply is there, a Reply until the Final is, and a Final
        answers each Reply that arrives.
        """
        request, reply, final = self.deliveries
        return 1 / request + 1 / reply - 1, 1 / (reply * final), 1 / final

    @property
    def bytes(self) -> float:
        """Of samples that all participants send, on average."""
        sizes = (self.sizes.request, self.sizes.reply, self.sizes.final)
        return self.pairs * sum(size * often for size, often in zip(sizes, self.sent, strict=True))

    @property
    def seconds(self) -> tuple[float, float]:
        """Of all cores of a host: start, Replies and Finals; then what the stack does."""
        costs = self.costs
        on_host = self.participants / self.machines / self.cores / _MILLI
        pairs = (self.participants - 1) / 2
        shake = costs.start + pairs * (costs.initiator + costs.responder)
        return on_host * shake, on_host * 2 * pairs * costs.stack

    @property
    def in_reassembly(self) -> int:
        """Bytes that a host holds if each peer's largest message arrives at once."""
        if max(self.datagrams(self.sizes.reply)) == 1:
            return 0
        frames = sum(self.datagrams(self.sizes.reply))
        return round(
            frames * FRAME_MEMORY * (self.participants - 1) * self.participants / self.machines
        )

    @property
    def overflows(self) -> bool:
        """Whether datagrams may get lost because a host has no memory to reassemble them."""
        return self.in_reassembly > self.threshold


def delivered_before_full(size: int, loss: float, threshold: int = IPFRAG_HIGH_THRESH) -> float:
    """Datagrams of `size` bytes that arrive within 30 s before incomplete ones fill the memory.

    Each incomplete one holds what arrived of it; when they fill `threshold` bytes, none arrives.
    Infinite without loss, or if a datagram is one frame.
    """
    frames = -(-size // FRAME)
    whole = (1 - loss) ** frames
    if frames == 1 or whole == 1:
        return float("inf")
    held = (1 - loss) * frames * FRAME_MEMORY
    return threshold / held / (1 - whole) * whole
