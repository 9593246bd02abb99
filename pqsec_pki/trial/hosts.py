"""Runs participants of a stack, each on a host of its own, until all have met."""

import selectors
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

from pqsec_pki._dataclass import dataclass
from pqsec_pki.trial.host_process import (
    HostProcess,
    kernel_counters,
    processor_seconds,
    running_host,
)
from pqsec_pki.trial.network import Network, alone
from pqsec_pki.trial.segment import Link, Segment, SegmentError, segment

_PAUSE = 0.1
_START = 120.0
"""Seconds until all processes run."""
_REPAIR = 3.0
"""Seconds in which a stack repeats samples that were lost, besides ten delays of the link."""
_SPARE = 60.0
"""Further seconds after which a host ends by itself, if this process was killed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostsSetup:
    """What runs on the hosts."""

    program: Sequence[str]
    """The command line of a peer, without its arguments."""
    environments: Sequence[Mapping[str, str]]
    """The variables of each host that name its configuration."""
    domain: int
    topic: str
    link: Link
    timeout: float
    """Seconds in which all should meet."""
    samples: int
    """Samples that each then sends to all others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostOutcome:
    """What one host did; times are seconds from the line that lets all join."""

    joined: float | None
    """The time at which its participant was created."""
    met: tuple[float, ...]
    """Times at which its writer and reader first matched those of one other host, two, ..."""
    received: int
    """Samples of others."""
    cpu: float
    """Seconds of the processor until all had met."""
    kernel: Mapping[str, int]
    """Counters of its network until then: see `host_process.KERNEL`."""
    signal: str | None
    """The signal that killed it, unless pqsec sent it."""
    log: tuple[str, ...]
    """The stack's messages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostsRun:
    """The result of a run."""

    hosts: tuple[HostOutcome, ...]
    counts: Mapping[str, int | float]
    """The switch's counts until all had met: see `_switch.Counts`."""
    samples_lost: int | None
    """Samples that did not arrive, one for each receiver; None unless all had met."""

    @property
    def complete(self) -> int:
        """Hosts that met all others."""
        return sum(len(each.met) >= len(self.hosts) - 1 for each in self.hosts)


def run_hosts(setup: HostsSetup) -> HostsRun:
    """Start all hosts, let all join, and wait until all have met; then each sends its samples.

    SegmentError if network namespaces are not permitted. An interruption kills all hosts.
    """
    return alone(lambda network: _run_hosts(setup, network))


def _run_hosts(setup: HostsSetup, network: Network) -> HostsRun:
    with segment(setup.link) as ethernet, _hosts(setup, ethernet) as hosts:
        running, others = _RunningHosts(hosts, network), len(hosts) - 1
        ethernet.connect()
        ethernet.counted()  # now the switch runs
        running.until(lambda each: bool(each.times("ready")), _START)
        start = time.monotonic()
        running.tell("go")
        running.until(lambda each: len(each.met) >= others, setup.timeout)
        counts = ethernet.counted()
        ends = [each.process.pid for each in hosts]
        measured = [(processor_seconds(each), kernel_counters(each)) for each in ends]
        met = [tuple(when - start for when in each.met) for each in hosts]
        lost = None
        if all(len(each) >= others for each in met):
            lost = running.exchange(setup.samples, _REPAIR + 10 * setup.link.delay)
        outcomes = [
            HostOutcome(
                joined=next((when - start for when in host.times("joined")[-1:]), None),
                met=when,
                received=host.received,
                cpu=cpu,
                kernel=kernel,
                signal=host.signal,
                log=host.log,
            )
            for host, when, (cpu, kernel) in zip(hosts, met, measured, strict=True)
        ]
    return HostsRun(hosts=tuple(outcomes), counts=counts, samples_lost=lost)


@contextmanager
def _hosts(setup: HostsSetup, ethernet: Segment) -> Iterator[list[HostProcess]]:
    """All hosts, which are in their namespaces and wait."""
    seconds = str(_START + setup.timeout + _SPARE)
    with ExitStack() as stack:
        hosts = []
        for number, environment in enumerate(setup.environments):
            ethernet.add_host()
            words = (str(setup.domain), setup.topic, f"host{number}", seconds)
            hosts.append(stack.enter_context(running_host(setup.program, environment, words)))
        yield hosts


class _RunningHosts:
    """All hosts, and what they say."""

    def __init__(self, hosts: Sequence[HostProcess], network: Network) -> None:
        self._hosts, self._network = hosts, network
        self._ready = selectors.DefaultSelector()
        for each in hosts:
            self._ready.register(each.output, selectors.EVENT_READ, each)

    def tell(self, line: str) -> None:
        for each in self._hosts:
            each.tell(line)

    def until(self, is_so: Callable[[HostProcess], bool], seconds: float) -> bool:
        """Wait until it is so of each host, or so many seconds; SegmentError if asked to end."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for key, _ in self._ready.select(_PAUSE):
                if not key.data.hear():
                    self._ready.unregister(key.fileobj)
            if not self._network.pause(0):
                raise SegmentError("the run was interrupted")
            if all(each.ended or is_so(each) for each in self._hosts):
                return True
        return False

    def exchange(self, samples: int, repair: float) -> int:
        """The samples that do not arrive when each host sends so many to all others."""
        if not samples:  # to a peer, 0 only asks what it has received
            return 0
        expected = samples * (len(self._hosts) - 1)
        self.tell(str(samples))
        self.until(lambda each: bool(each.times("sent")), _SPARE)
        end = time.monotonic() + repair
        while True:
            lost = sum(max(0, expected - each) for each in self._received())
            if not lost or time.monotonic() > end:
                return lost
            self._network.pause(_PAUSE)

    def _received(self) -> list[int]:
        """What each has received of others, by its own words now."""
        answers = 1 + max(len(each.times("received")) for each in self._hosts)
        self.tell("0")
        self.until(lambda each: len(each.times("received")) >= answers, _SPARE)
        return [each.received for each in self._hosts]
