"""One participant on a host of its own: its process, and what it says (peers/cyclonedds_host.h)."""

import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import field
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.trial.words import words

ENDPOINTS = ("writer", "reader")
_WORDS = {"ready", "joined", "sent", "received", *ENDPOINTS}
_LARGEST = 1 << 16
_MAX_LOG = 1 << 16
"""Bytes of a stack's own messages that are kept."""
_OWN = 1
"""A writer is matched with the reader of its own participant too, and first."""


@dataclass(slots=True)
class HostProcess:
    """A running host."""

    process: "subprocess.Popen[bytes]"
    _said: list[tuple[str, int, float]] = field(default_factory=list)
    _log: bytes = b""
    _rest: bytes = b""

    @property
    def ended(self) -> bool:
        """Whether it ended by itself."""
        return self.process.poll() is not None

    @property
    def output(self) -> int:
        """The file that it writes to."""
        assert self.process.stdout  # noqa: S101 -- opened as a pipe
        return self.process.stdout.fileno()

    def hear(self) -> bool:
        """Read its output; False if the output has ended."""
        heard = os.read(self.output, _LARGEST)
        *lines, self._rest = (self._rest + heard).split(b"\n")
        for line in lines:
            said = _parsed(line)
            if said:
                self._said.append(said)
            elif len(self._log) < _MAX_LOG:
                self._log += line + b"\n"
        return bool(heard)

    def tell(self, line: str) -> None:
        """Write a line to its input; the process may have ended."""
        assert self.process.stdin  # noqa: S101 -- opened as a pipe
        with suppress(BrokenPipeError):
            self.process.stdin.write(f"{line}\n".encode())

    def times(self, word: str) -> list[float]:
        """The times at which it wrote `word`, by time.monotonic."""
        return [when for said, _, when in self._said if said == word]

    @property
    def received(self) -> int:
        """The samples of others that it had when it was last asked."""
        return max((number for said, number, _ in self._said if said == "received"), default=0)

    @property
    def met(self) -> list[float]:
        """Times at which its writer and its reader first matched those of one other, two, ..."""
        most = {each: [0.0] * _OWN for each in ENDPOINTS}
        for said, number, when in self._said:
            if said in most:
                most[said] += [when] * (number - len(most[said]))
        return [max(both) for both in zip(*most.values(), strict=False)][_OWN:]

    @property
    def log(self) -> tuple[str, ...]:
        """The stack's messages."""
        return words(self._log.decode(errors="replace"))

    @property
    def signal(self) -> str | None:
        """The signal that killed it."""
        code = self.process.poll() or 0
        return signal.Signals(-code).name if code < 0 else None


def _parsed(line: bytes) -> tuple[str, int, float] | None:
    """A word, a number and a time; None for what a stack prints."""
    word, *values = line.decode(errors="replace").split(" ")
    try:
        number, when = map(float, values or ("0", "0"))
    except ValueError:
        return None
    return (word, int(number), when) if word in _WORDS else None


@contextmanager
def running_host(
    program: Sequence[str], environment: Mapping[str, str], words: Sequence[str]
) -> Iterator[HostProcess]:
    """Run a host in the network of this thread; it is killed when the block ends."""
    with tempfile.TemporaryDirectory(prefix="pqsec-host-") as folder:
        process = subprocess.Popen(  # noqa: S603 -- a peer that was compiled here
            [*program, "host", *words],
            cwd=folder,  # a stack may leave files where it runs
            env=os.environ | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
            start_new_session=True,
        )
        try:
            yield HostProcess(process)
        finally:
            process.kill()
            process.communicate()


KERNEL = {
    "OutDatagrams": "Udp",
    "InDatagrams": "Udp",
    "RcvbufErrors": "Udp",
    "ReasmFails": "Ip",
}
"""Counters of a network, and their protocol in /proc/PID/net/snmp (proc_pid_net(5)): datagrams
sent, received, and dropped because their receiver was too slow; and not reassembled."""


QUEUE_DROPS = "QueueDrops"
"""Frames that were lost because the switch was too slow."""
_DROPPED = 11
"""The field of /proc/PID/net/dev with them."""


def kernel_counters(process: int) -> dict[str, int]:
    """Counters in KERNEL of its network, and QUEUE_DROPS; empty if the process has ended."""
    try:
        lines = Path(f"/proc/{process}/net/snmp").read_text().splitlines()
    except OSError:
        return {}
    found: dict[tuple[str, str], int] = {}
    for names, values in zip(lines[::2], lines[1::2], strict=False):
        protocol, *words = names.split()
        numbers = map(int, values.split()[1:])
        found |= {(protocol.rstrip(":"), word): n for word, n in zip(words, numbers, strict=False)}
    counters = {name: found.get((protocol, name), 0) for name, protocol in KERNEL.items()}
    return counters | {QUEUE_DROPS: _queue_drops(process)}


def _queue_drops(process: int) -> int:
    """Frames that its interface could not send; 0 if it has ended."""
    try:
        lines = Path(f"/proc/{process}/net/dev").read_text().splitlines()
    except OSError:
        return 0
    fields = (line.partition(":")[2].split() for line in lines if line.strip().startswith("eth0:"))
    return sum(int(each[_DROPPED]) for each in fields)


def processor_seconds(process: int) -> float:
    """Seconds of the processor that it has taken; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
