"""The agent's socket, of which there is only one, and the identity of the connected process."""

import fcntl
import os
import socket
import stat
import struct
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from pqsec_pki._files import disk_errors
from pqsec_pki.errors import FileError, shown
from pqsec_pki.plugin.agent_folder import AgentFolder

BACKLOG = 128
LOCK_SECONDS = 2.0
_FIRST_GIVEN = 3
"""The file descriptor of the first socket that systemd passes (sd_listen_fds(3))."""


def given(environment: Mapping[str, str], place: AgentFolder) -> socket.socket | None:
    """The socket that systemd listens at for this process; None if it does not.

    FileError if the library does not look for the agent at that socket.
    """
    if environment.get("LISTEN_PID") != str(os.getpid()):
        return None
    try:
        mode = os.fstat(_FIRST_GIVEN).st_mode
        if environment.get("LISTEN_FDS") != "1" or not stat.S_ISSOCK(mode):
            raise FileError("systemd must pass exactly one socket")
        listener = socket.socket(fileno=_FIRST_GIVEN)
        at, listens = listener.getsockname(), _option(listener, socket.SO_ACCEPTCONN)
        is_stream = (listener.family, listener.type) == (socket.AF_UNIX, socket.SOCK_STREAM)
    except OSError as error:
        raise FileError(f"what systemd passed is not a socket: {error.strerror}") from error
    if not is_stream or not listens or at != str(place.socket):
        listener.detach()
        raise FileError(
            f"systemd listens at {at!r}, and the library connects to {place.socket}",
            hint="ListenStream=%t/pqsec/agent.sock",
        )
    listener.set_inheritable(False)
    listener.settimeout(0)
    return listener


def _option(link: socket.socket, name: int) -> int:
    return link.getsockopt(socket.SOL_SOCKET, name)


@contextmanager
def lock(path: Path) -> Iterator[None]:
    """Lock, so that one agent at a time starts or stops. FileError if another takes too long."""
    until = time.monotonic() + LOCK_SECONDS
    with disk_errors(path):
        file = path.open("w")
    with file:
        while not _is_locked(file.fileno()):
            if time.monotonic() > until:
                raise FileError(f"{path}: another agent has locked it")
            time.sleep(0.01)
        yield


def _is_locked(handle: int) -> bool:
    """Whether this process has locked it now."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def answers(path: Path) -> bool:
    """Whether a process listens there."""
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(0)
        try:
            link.connect(str(path))
        except BlockingIOError:  # its queue is full
            return True
        except OSError:
            return False
        return True


def remove_unused(paths: Iterable[Path]) -> None:
    """Remove the sockets at which no process listens."""
    for path in paths:
        if not answers(path):
            path.unlink(missing_ok=True)


def made(path: Path) -> tuple[int, int]:
    """(inode, time of change) of the file: the inode of a deleted file may be reused."""
    found = path.stat()
    return found.st_ino, found.st_ctime_ns


def bound(path: Path) -> socket.socket:
    """A socket at `path`, 0600; it replaces one at which no process listens."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        path.unlink(missing_ok=True)
        listener.bind(str(path))
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        raise FileError(f"{path}: {error.strerror or error}") from error
    finally:
        os.umask(before)
    listener.settimeout(0)
    return listener


def peer(link: socket.socket) -> tuple[int, int]:
    """Process and user at the other end."""
    form = struct.Struct("iII")
    process, user, _ = form.unpack(
        link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, form.size)
    )
    return process, user


def name_of(process: int) -> str:
    with suppress(OSError):
        name = Path(f"/proc/{process}/comm").read_text(errors="replace").strip()
        return f"{shown(name)}[{process}]"  # a process may choose any name
    return f"[{process}]"
