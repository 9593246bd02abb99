"""What is asked: a fleet, its machines and its network; and the timers of Cyclone DDS.

The timers are from Cyclone DDS's source, of its handshake and its discovery in one version each. In
0.10.2, announcements were once seen repeated after 30 s only.
SETTLE and LATE are fitted to bench/calibration.csv.
"""

from functools import cached_property
from math import exp

from pqsec_pki._dataclass import dataclass
from pqsec_pki.estimation.costs import Costs
from pqsec_pki.handshake import MessageSizes
from pqsec_pki.stacks import FRAME_MEMORY, IPFRAG_HIGH_THRESH, SMALL_FRAGMENT, frames_of

RESEND = 1.0
"""Seconds until a Request or Reply without an answer is sent again."""
FINALS = 2
"""How often a Final is sent for each Reply that arrives: captured with 0.10.2."""
ANNOUNCE = 8.0
"""Seconds between announcements of a participant, with the default lease of 10 s."""
ANSWER = 1.0
"""Seconds until who heard an announcement answers that peer again, ANSWERS times in all."""
ANSWERS = 4
BASE = 0.11
"""Seconds that each pair waits in any case: 10 ms before the handshake, 100 ms after it."""
SETTLE = (0.1, 0.3)
"""Seconds from then until its endpoints are matched, at least and at most: heartbeats of 100 ms for
the keys and for the endpoints."""
LATE_SHARE, LATE = 0.3, 0.3
"""The share of pairs that wait longer, and seconds: seen with three or more participants, also with
Cyclone DDS's own plugins; fitted, the cause was not examined."""
GIVE_UP = 100.0
"""Seconds after which a handshake ends without success."""
REASSEMBLY = 30.0
"""Seconds for which a host holds an incomplete datagram (net.ipv4.ipfrag_time)."""
HEADERS = 92
"""Bytes of UDP, RTPS and DATA_FRAG around a fragment."""
_MILLI = 1000
_MOST_GROWTH = 30.0
"""The largest exponent that is computed: its power is 10^13."""
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
    """The sizes of each participant, if they are known."""
    loss: float = 0.0
    """The share of frames that get lost, 0 <= loss < 1."""
    fragment: int = SMALL_FRAGMENT
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
    def host_count(self) -> int:
        """How many hosts run participants."""
        return min(self.hosts or self.participants, self.participants)

    @property
    def pairs(self) -> int:
        """How many handshakes a full mesh takes."""
        return self.participants * (self.participants - 1) // 2

    def datagrams(self, size: int) -> list[int]:
        """The frames of each datagram that carries a sample of `size` bytes."""
        whole, rest = divmod(size, self.fragment)
        parts = [self.fragment] * whole + [rest] * (rest > 0)
        return [frames_of(part + HEADERS) for part in parts]

    def frames(self, size: int) -> int:
        """The frames of all these datagrams."""
        return sum(self.datagrams(size))

    def delivery(self, size: int) -> float:
        """The probability that all frames of a sample arrive, if there is memory for them."""
        return max((1 - self.loss) ** self.frames(size), _LEAST)

    @cached_property
    def deliveries(self) -> tuple[float, float, float]:
        """The probability that a Request arrives, a Reply, and one of the FINALS that answer it."""
        request, reply, final = map(self.delivery, self.sizes)
        return request, reply, 1 - (1 - final) ** FINALS

    @property
    def sent(self) -> tuple[float, float, float]:
        """How often each message of a pair is sent, on average.

        A Request is repeated until the Reply is there, a Reply until the Final is, and FINALS
        answer each Reply that arrives.
        """
        request, reply, final = self.deliveries
        return 1 / request + 1 / reply - 1, 1 / (reply * final), FINALS / final

    @property
    def bytes(self) -> float:
        """Bytes of the samples that all participants send, on average."""
        sent = zip(self.sizes, self.sent, strict=True)
        return self.pairs * sum(size * often for size, often in sent)

    @property
    def work(self) -> tuple[float, float]:
        """Seconds of all cores of a host: for starts and handshakes; then for the stack."""
        costs = self.costs
        on_host = self.participants / self.host_count / self.cores / _MILLI
        pairs = (self.participants - 1) / 2
        handshakes = costs.start + pairs * (costs.initiator + costs.responder)
        return on_host * handshakes, on_host * 2 * pairs * costs.stack

    @property
    def busy(self) -> float:
        """Seconds of all cores of a host for all its pairs, with what waiting pairs repeat."""
        return self.served(1.0)

    def served(self, share: float) -> float:
        """Seconds until the cores of a host have served that share of its pairs.

        First all handshakes, then what the stack does for each pair, which costs more the longer
        the pair has waited. No pair waits if the participants start slowly enough.
        """
        handshakes, stack = self.work
        waiting = max(0.0, 1 - self.start_within / (handshakes + stack or 1.0))
        growth = waiting * self.costs.repeat / (self.costs.stack or 1.0)
        if growth == 0:
            return handshakes + stack * share
        exponent = min(growth * stack * share, _MOST_GROWTH)
        return (handshakes + 1 / growth) * exp(exponent) - 1 / growth

    @property
    def in_reassembly(self) -> int:
        """Bytes that a host holds if each peer's largest message arrives at once."""
        if max(self.datagrams(self.sizes.reply)) == 1:
            return 0
        held = self.frames(self.sizes.reply) * FRAME_MEMORY
        return round(held * (self.participants - 1) * self.participants / self.host_count)

    @property
    def overflows(self) -> bool:
        """Whether datagrams may get lost because a host has no memory to reassemble them."""
        return self.in_reassembly > self.threshold

    def to_json(self) -> dict[str, object]:
        """The fleet, and what follows from it without a model of time."""
        return {
            "participants": self.participants,
            "hosts": self.host_count,
            "cores": self.cores,
            "loss": self.loss,
            "fragment_bytes": self.fragment,
            "start_within_s": self.start_within,
            "sample_bytes": self.sizes._asdict(),
            "frames": {name: self.frames(size) for name, size in self.sizes._asdict().items()},
            "handshakes": self.pairs,
            "bytes": round(self.bytes),
            "cpu_s": round(self.busy * self.host_count * self.cores, 3),
            "busy_s": round(self.busy, 3),
            "costs": self.costs,
        }
