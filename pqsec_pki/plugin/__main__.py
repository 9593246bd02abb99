"""The agent as a process: `python -I -m pqsec_pki.plugin [--detach] SOCKET [IDLE-SECONDS]`.

The shim starts it so, without the command line's weight. With --detach the process ends
once it listens, and a child goes on. The log goes to stderr. Like the command line it has
a clock; nothing else in the room has.
"""

import os
import stat
import sys
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin.place import Place
from pqsec_pki.plugin.server import Agent

IDLE_SECONDS = 300.0
MAX_LOG = 1 << 20
"""Bytes; then it begins anew."""


def _now() -> datetime:
    return datetime.now(UTC)


def _log(line: str) -> None:
    with suppress(OSError):  # a full disk is no reason to end
        status = os.fstat(sys.stderr.fileno())
        if stat.S_ISREG(status.st_mode) and status.st_size > MAX_LOG:
            os.ftruncate(sys.stderr.fileno(), 0)
        sys.stderr.write(f"{_now():%Y-%m-%dT%H:%M:%SZ} {line}\n")
        sys.stderr.flush()


def _detach() -> None:
    """Go on as a child, and let who waits for this process know that all is well."""
    if os.fork():
        os._exit(0)


def main(arguments: list[str]) -> int:
    """0 when it has ended, 3 if it could not begin."""
    os.closerange(3, 1 << 20)  # what a careless host left open
    detach = arguments[:1] == ["--detach"]
    place, *more = arguments[detach:]
    idle = float(more[0]) if more else IDLE_SECONDS
    try:
        Agent(Place(Path(place)), idle, _now, _log).run(_detach if detach else lambda: None)
    except PqsecError as error:
        _log(str(error))
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
