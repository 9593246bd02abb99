"""Runs participants of a stack, each on a host of its own, until all have met."""

import selectors
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from pqsec_pki._dataclass import dataclass
from pqsec_pki.trial._proc import network_counters, processor_seconds
from pqsec_pki.trial.host_process import HostProcess, running_host
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
    """For each host the variables that name its configuration."""
    domain: int
    topic: str
    link: Link
    timeout: float
    """Seconds in which all should meet."""
    samples: int
    """Samples that each then sends to all others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostOutcome:
    """What one host did; times are seconds from when all were told to join."""

    joined: float | None
    """When its participant was created."""
    met: tuple[float, ...]
    """When its writer and its reader were first matched with those of one other host, two, ..."""
    received: int
    """Samples of others."""
    cpu: float
    """Seconds of the processor until all had met."""
    kernel: Mapping[str, int]
    """Counters of its network until then: see `_proc.network_counters`."""
    signal: str | None
    """The signal that killed it, unless pqsec sent it."""
    log: tuple[str, ...]
    """The stack's messages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostsRun:
    """What came of it."""

    hosts: tuple[HostOutcome, ...]
    counts: Mapping[str, int | float]
    """Of the switch until all had met: see `_switch.Counts`."""
    samples_lost: int | None
    """Samples that did not arrive, one for each receiver; None unless all had met."""

    @property
    def complete(self) -> int:
        """Hosts that met all others."""
        return sum(len(each.met) >= len(self.hosts) - 1 for each in self.hosts)


def run_hosts(setup: HostsSetup) -> HostsRun:
    """Start all hosts, tell all to join, and wait until all have met; then each sends its samples.

    SegmentError if network namespaces are not permitted. An interruption kills all hosts.
    """
    return alone(lambda network: _run_hosts(setup, network))


def _run_hosts(setup: HostsSetup, network: Network) -> HostsRun:
    with segment(setup.link) as ethernet, _started(setup, ethernet) as processes:
        hosts, others = _Hosts(processes, network), len(processes) - 1
        ethernet.connect()
        ethernet.counted()  # now the switch runs
        hosts.wait(lambda each: bool(each.times("ready")), _START)
        start = time.monotonic()
        hosts.send("go")
        hosts.wait(lambda each: len(each.met) >= others, setup.timeout)
        counts = ethernet.counted()
        outcomes = [_outcome(each, start) for each in processes]
        lost = None
        if all(len(each.met) >= others for each in outcomes):
            lost = hosts.exchange(setup.samples, _REPAIR + 10 * setup.link.delay)
        ended = [
            replace(one, received=each.received, signal=each.signal, log=each.log)
            for one, each in zip(outcomes, processes, strict=True)
        ]
    return HostsRun(hosts=tuple(ended), counts=counts, samples_lost=lost)


def _outcome(host: HostProcess, start: float) -> HostOutcome:
    """What it has done until now; no samples were sent."""
    process = host.process.pid
    return HostOutcome(
        joined=next((when - start for when in host.times("joined")[-1:]), None),
        met=tuple(when - start for when in host.met),
        received=0,
        cpu=processor_seconds(process),
        kernel=network_counters(process),
        signal=host.signal,
        log=host.log,
    )


@contextmanager
def _started(setup: HostsSetup, ethernet: Segment) -> Iterator[list[HostProcess]]:
    """All hosts, which are in their namespaces and wait."""
    seconds = str(_START + setup.timeout + _SPARE)
    with ExitStack() as stack:
        hosts = []
        for number, environment in enumerate(setup.environments):
            ethernet.add_host()
            arguments = (str(setup.domain), setup.topic, f"host{number}", seconds)
            hosts.append(stack.enter_context(running_host(setup.program, environment, arguments)))
        yield hosts


class _Hosts:
    """All hosts together."""

    def __init__(self, hosts: Sequence[HostProcess], network: Network) -> None:
        self._hosts, self._network = hosts, network
        self._ready = selectors.DefaultSelector()
        for each in hosts:
            self._ready.register(each.output, selectors.EVENT_READ, each)

    def send(self, line: str) -> None:
        """Send each host the line."""
        for each in self._hosts:
            each.send(line)

    def wait(self, is_done: Callable[[HostProcess], bool], seconds: float) -> None:
        """Read what hosts print until each is done or has ended, at most so many seconds.

        SegmentError if this process is asked to end.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for key, _ in self._ready.select(_PAUSE):
                if not key.data.read():
                    self._ready.unregister(key.fileobj)
            if not self._network.pause(0):
                raise SegmentError("the run was interrupted")
            if all(each.ended or is_done(each) for each in self._hosts):
                return

    def exchange(self, samples: int, repair: float) -> int:
        """The samples that do not arrive when each host sends so many to all others."""
        expected = samples * (len(self._hosts) - 1)
        self.send(str(samples))
        self.wait(lambda each: bool(each.times("sent")), _SPARE)
        end = time.monotonic() + repair
        while True:
            lost = sum(max(0, expected - each) for each in self._received())
            if not lost or time.monotonic() > end:
                return lost
            self._network.pause(_PAUSE)

    def _received(self) -> list[int]:
        """How many samples of others each says that it has received."""
        answers = 1 + max(len(each.times("received")) for each in self._hosts)
        self.send("0")
        self.wait(lambda each: len(each.times("received")) >= answers, _SPARE)
        return [each.received for each in self._hosts]
