"""One participant of a trial: a process of its own, and what it said."""

import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO

MAX_LOG = 1 << 20
"""Bytes of what one participant says; a stack can be talkative."""
_REFUSED = 3
"""Exit code of a peer whose stack refused to make something."""


class Act(StrEnum):
    """What a participant does."""

    SEND = "send"
    RECEIVE = "receive"


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """What one participant is told."""

    name: str
    """Who it is, for people."""
    act: Act
    text: str = ""
    """What it sends."""
    environment: Mapping[str, str]
    """With it the stack finds its configuration."""
    warnings: tuple[str, ...] = ()
    """What is to be said of its credentials."""
    unauthenticated: bool = False
    """Whether it has no credentials: nobody waits for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerOutcome:
    """How it went for one participant."""

    role: Role
    joined: bool
    matched: bool
    """Whether a sender saw a receiver."""
    received: str | None
    refused: str | None
    """What its own stack refused to make, and why."""
    signal: str | None
    """What killed it, if it did not end by itself or by us."""
    log: str
    """All that it and its stack said."""


class Peer:
    """A running participant."""

    def __init__(self, role: Role, process: "subprocess.Popen[bytes]", said: IO[bytes]) -> None:
        self.role, self._process, self._said = role, process, said
        self._stopped = False

    @property
    def ended(self) -> bool:
        """Whether it ended by itself."""
        return self._process.poll() is not None

    @property
    def refused(self) -> bool:
        """Whether it ended since its own stack refused."""
        return self._process.poll() == _REFUSED

    @property
    def outcome(self) -> PeerOutcome:
        """How it has gone so far."""
        # pread: the participant writes on at the offset that both share.
        log = os.pread(self._said.fileno(), MAX_LOG, 0).decode(errors="replace")
        code = self._process.poll() or 0
        return PeerOutcome(
            role=self.role,
            joined="joined" in log.splitlines(),
            matched="matched" in log.splitlines(),
            received=_said(log, "received "),
            refused=_said(log, "refused "),
            signal=signal.Signals(-code).name if code < 0 and not self._stopped else None,
            log=log,
        )

    def stop(self) -> None:
        """End it, with all it started."""
        self._stopped = not self.ended
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def _said(log: str, what: str) -> str | None:
    lines = [line.removeprefix(what) for line in log.splitlines() if line.startswith(what)]
    return lines[0] if lines else None


def _log_in(folder: str) -> IO[bytes]:
    return (Path(folder) / "log").open("w+b")


@contextmanager
def playing(
    program: Sequence[str], role: Role, *, domain: int, topic: str, seconds: float
) -> Iterator[Peer]:
    """A participant that plays its role, for `seconds` at most, and is gone after."""
    words = [role.act.value, str(domain), topic, role.text, str(seconds)]
    with tempfile.TemporaryDirectory(prefix="pqsec-peer-") as folder, _log_in(folder) as said:
        process = subprocess.Popen(  # noqa: S603 -- a peer that was compiled here
            [*program, *words],
            cwd=folder,  # a stack may leave files where it runs
            env=os.environ | role.environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        peer = Peer(role, process, said)
        try:
            yield peer
        finally:
            peer.stop()
