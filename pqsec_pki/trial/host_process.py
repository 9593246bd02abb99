"""One participant on a host of its own: its process, and what it prints (cyclonedds_host.h)."""

import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import field

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
    _events: list[tuple[str, int, float]] = field(default_factory=list)
    """A word, a number and the time by time.monotonic."""
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

    def read(self) -> bool:
        """Read what it has printed; False at the end."""
        data = os.read(self.output, _LARGEST)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if event := _parsed(line):
                self._events.append(event)
            elif len(self._log) < _MAX_LOG:
                self._log += line + b"\n"
        return bool(data)

    def send(self, line: str) -> None:
        """Write a line to it, unless it has ended."""
        assert self.process.stdin  # noqa: S101 -- opened as a pipe
        with suppress(BrokenPipeError):
            self.process.stdin.write(f"{line}\n".encode())

    def times(self, word: str) -> list[float]:
        """The times of the events with that word."""
        return [when for each, _, when in self._events if each == word]

    @property
    def received(self) -> int:
        """The samples of others that it had when it was last asked."""
        return max((number for each, number, _ in self._events if each == "received"), default=0)

    @property
    def met(self) -> list[float]:
        """When its writer and its reader were first matched with those of one other, two, ..."""
        most = {each: [0.0] * _OWN for each in ENDPOINTS}
        for word, number, when in self._events:
            if word in most:
                most[word] += [when] * (number - len(most[word]))
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
    """The event; None for what a stack prints."""
    word, *values = line.decode(errors="replace").split(" ")
    try:
        number, when = map(float, values or ("0", "0"))
    except ValueError:
        return None
    return (word, int(number), when) if word in _WORDS else None


@contextmanager
def running_host(
    program: Sequence[str], environment: Mapping[str, str], arguments: Sequence[str]
) -> Iterator[HostProcess]:
    """Run a host in the network of this thread; it is killed when the block ends."""
    with tempfile.TemporaryDirectory(prefix="pqsec-host-") as folder:
        process = subprocess.Popen(  # noqa: S603 -- a peer that was compiled here
            [*program, "host", *arguments],
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
