"""The agent as a process: `python -I -m pqsec_pki.plugin [--detach] SOCKET [IDLE-SECONDS]`.

Without IDLE-SECONDS it stays: see `staying.py`.

The shim runs this module, which starts faster than `pqsec`. With --detach the process ends when
the socket listens, and a child continues. The log is written to stderr. Only this module of the
room has a clock.
"""

import fcntl
import gc
import os
import stat
import sys
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from pqsec_pki._times import rfc3339
from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin.agent_folder import AgentFolder
from pqsec_pki.plugin.server import Agent
from pqsec_pki.plugin.system import undo_hosts_settings

IDLE_SECONDS = 300.0
"""How often an agent without hosts looks whether it should still stay."""
MAX_LOG = 1 << 20
"""Bytes; a longer log loses its older half."""


def _now() -> datetime:
    return datetime.now(UTC)


def _log(line: str) -> None:
    handle = sys.stderr.fileno()
    with suppress(OSError):  # a full disk does not end it
        status = os.fstat(handle)
        if stat.S_ISREG(status.st_mode) and status.st_size > MAX_LOG:
            _halve(handle)
        sys.stderr.write(f"{rfc3339(_now())} {line}\n")
        sys.stderr.flush()


def _halve(handle: int) -> None:
    """Remove the older half of the log, unless another process of the agent does it now.

    It does not wait for the lock, since any process of the user could keep it.
    """
    with Path(f"/proc/self/fd/{handle}").open("r+b") as file, suppress(BlockingIOError):
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until the file is closed
        size = file.seek(0, os.SEEK_END)
        if size > MAX_LOG:
            file.seek(size - MAX_LOG // 2)
            _, _, kept = file.read().partition(b"\n")
            os.ftruncate(handle, 0)
            os.lseek(handle, 0, os.SEEK_SET)
            os.write(handle, kept)


def _detach() -> None:
    """Continue as a child. The exit of this process shows its parent that the agent listens.

    The parent is a host, which may be bound to one core: the agent serves others too.
    """
    if os.fork():
        os._exit(0)
    with suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))


def main(arguments: list[str]) -> int:
    """Run the agent. Returns 0 after it has stopped, 3 if it could not start."""
    gc.freeze()  # imported modules are never freed
    gc.enable()
    os.closerange(3, 1 << 20)  # files that the host did not close
    detach = arguments[:1] == ["--detach"]
    place, *more = arguments[detach:]
    idle = float(more[0]) if more else IDLE_SECONDS
    undo_hosts_settings()
    starter = os.getppid() if detach else None
    agent = Agent(AgentFolder(Path(place)), idle, _now, _log, stays=not more, starter=starter)
    try:
        agent.run(_detach if detach else lambda: None)
    except PqsecError as error:
        _log(str(error))
        return error.exit_code
    return 0


def start() -> None:
    """Run with the arguments of the command line."""
    sys.exit(main(sys.argv[1:]))


if __name__ == "__main__":
    start()
