"""One participant of a trial: its process, and its output."""

import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import IO

from pqsec_pki._dataclass import dataclass

MAX_LOG = 1 << 20
"""Bytes of one participant's output that are read."""
_REFUSED = 3
"""Exit code of a peer whose stack refused to create an entity."""


class Act(StrEnum):
    """What a participant does."""

    SEND = "send"
    RECEIVE = "receive"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRole:
    """The task and configuration of one participant."""

    name: str
    """The name in messages."""
    act: Act
    text: str = ""
    """The text that it sends."""
    environment: Mapping[str, str]
    """Variables that name the stack's configuration."""
    warnings: tuple[str, ...] = ()
    """Warnings about its credentials."""
    unauthenticated: bool = False
    """Whether it has no credentials; the trial does not wait for it."""
    program: tuple[str, ...] = ()
    """The command line that plays it, if not the one of the trial."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerOutcome:
    """The outcome of a trial for one participant."""

    role: TrialRole
    joined: bool
    matched: bool
    """Whether a sender saw a receiver."""
    received: str | None
    refused: str | None
    """The entity that its own stack refused to create, and why."""
    signal: str | None
    """The signal that killed it, unless pqsec sent it."""
    log: str
    """The output of the participant and its stack."""


class PeerProcess:
    """A running participant."""

    def __init__(
        self, role: TrialRole, process: "subprocess.Popen[bytes]", output: IO[bytes]
    ) -> None:
        self.role, self._process, self._output = role, process, output
        self._stopped = False

    @property
    def ended(self) -> bool:
        """Whether it ended by itself."""
        return self._process.poll() is not None

    @property
    def refused(self) -> bool:
        """Whether it ended because its own stack refused."""
        return self._process.poll() == _REFUSED

    @property
    def outcome(self) -> PeerOutcome:
        """The outcome so far."""
        # pread keeps the file offset, which the participant shares and writes at.
        log = os.pread(self._output.fileno(), MAX_LOG, 0).decode(errors="replace")
        code = self._process.poll() or 0
        return PeerOutcome(
            role=self.role,
            joined="joined" in log.splitlines(),
            matched="matched" in log.splitlines(),
            received=_line_after(log, "received "),
            refused=_line_after(log, "refused "),
            signal=signal.Signals(-code).name if code < 0 and not self._stopped else None,
            log=log,
        )

    def stop(self) -> None:
        """Kill it, with all processes that it started."""
        self._stopped = not self.ended
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def _line_after(log: str, prefix: str) -> str | None:
    """The rest of the first line with `prefix`."""
    lines = [line.removeprefix(prefix) for line in log.splitlines() if line.startswith(prefix)]
    return lines[0] if lines else None


def _log_in(folder: str) -> IO[bytes]:
    return (Path(folder) / "log").open("w+b")


@contextmanager
def running_peer(
    program: Sequence[str], role: TrialRole, *, domain: int, topic: str, seconds: float
) -> Iterator[PeerProcess]:
    """Run a participant for `seconds` at most; it is killed when the block ends."""
    words = [role.act.value, str(domain), topic, role.text, str(seconds)]
    with tempfile.TemporaryDirectory(prefix="pqsec-peer-") as folder, _log_in(folder) as output:
        process = subprocess.Popen(  # noqa: S603 -- a peer that was compiled here
            [*(role.program or program), *words],
            cwd=folder,  # a stack may leave files where it runs
            env=os.environ | role.environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        peer = PeerProcess(role, process, output)
        try:
            yield peer
        finally:
            peer.stop()
