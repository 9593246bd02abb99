"""The agent's sockets: one thread that serves all connections in turn.

Calls take milliseconds, so nobody waits long, and what connections share needs no lock.
"""

import fcntl
import os
import resource
import selectors
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pqsec_pki.errors import FileError, PqsecError, shown
from pqsec_pki.plugin.authentication import Clock
from pqsec_pki.plugin.calls import CONTROL
from pqsec_pki.plugin.connection import Connection, House, Log
from pqsec_pki.plugin.place import Place

MAX_CONNECTIONS = 512
"""Two for each domain of a DDS process."""
_BACKLOG = 128
_AT_ONCE = 1 << 18
"""Octets that are read of one connection before it is another's turn."""
_LOCK_SECONDS = 2.0
_GRACE_SECONDS = 20.0
"""How long who started the agent may take to connect."""
_LONGEST_WAIT = 3600.0


class _Guest:
    """A connected socket: what it sent is in its connection, what it is owed here."""

    def __init__(self, link: socket.socket, connection: Connection) -> None:
        self.link, self.connection = link, connection
        self.outbox = bytearray()


class Agent:
    """Listens until it is told to stop, or nobody was connected for a while."""

    def __init__(self, place: Place, idle: float, clock: Clock, log: Log) -> None:
        self._place, self._idle, self._log = place, idle, log
        self._house = House(clock, log, self._status, self._stop)
        self._guests: set[_Guest] = set()
        self._stopping = False

    def run(self, ready: Callable[[], None] = lambda: None) -> bool:
        """False if another agent listens there. FileError if there is no place to listen.

        `ready` is called when it listens.
        """
        self._place.prepare()
        with _lock(self._place.lock):
            if _answers(self._place.socket):
                return False
            listener = _listening(self._place.socket)
            own = _made(self._place.socket)
        _limit()
        ready()
        self._selector = selectors.DefaultSelector()  # which would not outlive a fork
        self._selector.register(listener, selectors.EVENT_READ)
        self._log(f"listening at {self._place.socket}")
        with listener:
            self._serve(listener)
        with _lock(self._place.lock), suppress(FileNotFoundError):
            if _made(self._place.socket) == own:  # and not a later agent's
                self._place.socket.unlink()
        for guest in list(self._guests):
            self._part(guest)
        self._log("ended")
        return True

    def _serve(self, listener: socket.socket) -> None:
        end = time.monotonic() + max(self._idle, _GRACE_SECONDS)
        while not self._stopping and (self._guests or time.monotonic() < end):
            busy = bool(self._guests)
            wait = None if busy else min(end - time.monotonic(), _LONGEST_WAIT)
            for key, events in self._selector.select(wait):
                if key.fileobj is listener:
                    self._welcome(listener)
                else:
                    self._attend(key.data, events)
            if busy:
                end = time.monotonic() + self._idle

    def _welcome(self, listener: socket.socket) -> None:
        with suppress(OSError):  # it may have gone already
            link, _ = listener.accept()
            process, user = _peer(link)
            if user != os.geteuid() or len(self._guests) >= MAX_CONNECTIONS:
                self._log(f"process {process} of user {user} is not served")
                link.close()
                return
            link.settimeout(0)
            guest = _Guest(link, Connection(self._house, _name_of(process)))
            self._guests.add(guest)
            self._selector.register(link, selectors.EVENT_READ, guest)

    def _attend(self, guest: _Guest, events: int) -> None:
        try:
            if events & selectors.EVENT_READ:
                self._read(guest)
            while guest.outbox:
                del guest.outbox[: guest.link.send(guest.outbox)]
        except BlockingIOError:
            pass
        except (OSError, PqsecError) as error:
            if not isinstance(error, ConnectionError):  # who hangs up has done nothing wrong
                self._log(f"{guest.connection.what[0]}: {error}")
            self._part(guest)
            return
        # Who does not read answers is not heard either, so what it is owed stays small.
        waiting = selectors.EVENT_WRITE if guest.outbox else selectors.EVENT_READ
        self._selector.modify(guest.link, waiting, guest)

    def _read(self, guest: _Guest) -> None:
        octets = guest.link.recv(_AT_ONCE)
        if not octets:
            raise ConnectionResetError
        for answer in guest.connection.receive(octets):
            guest.outbox += answer

    def _part(self, guest: _Guest) -> None:
        self._guests.discard(guest)
        self._selector.unregister(guest.link)
        guest.link.close()

    def _status(self) -> dict[str, Any]:
        found = [guest.connection.what for guest in self._guests]
        return {
            "process": os.getpid(),
            "socket": str(self._place.socket),
            "connections": [
                {"process": who, "plugin": plugin, "objects": count}
                for who, plugin, count in sorted(found)
                if plugin != CONTROL
            ],
        }

    def _stop(self) -> None:
        self._stopping = True


def _limit() -> None:
    """No core file, which would hold keys; and files enough for all connections."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = 2 * MAX_CONNECTIONS
    if 0 <= soft < enough:
        resource.setrlimit(
            resource.RLIMIT_NOFILE, (min(enough, hard) if hard >= 0 else enough, hard)
        )


@contextmanager
def _lock(path: Path) -> Iterator[None]:
    """Only one agent at a time comes or goes. FileError if another takes too long."""
    until = time.monotonic() + _LOCK_SECONDS
    try:
        file = path.open("w")
    except OSError as error:
        raise FileError(f"{path}: {(error.strerror or '').lower()}") from error
    with file:
        while not _is_locked(file.fileno()):
            if time.monotonic() > until:
                raise FileError(f"{path}: another agent has it")
            time.sleep(0.01)
        yield


def _is_locked(handle: int) -> bool:
    """Whether it is now, and by us."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _answers(path: Path) -> bool:
    """Whether somebody listens there."""
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(0)
        try:
            link.connect(str(path))
        except BlockingIOError:  # so many that it does not come to it
            return True
        except OSError:
            return False
        return True


def _made(path: Path) -> tuple[int, int]:
    """Which file it is; the number of one that is gone may be given to the next."""
    found = path.stat()
    return found.st_ino, found.st_ctime_ns


def _listening(path: Path) -> socket.socket:
    """A socket at `path`, 0600, in place of one that nobody listens at."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        path.unlink(missing_ok=True)
        listener.bind(str(path))
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        raise FileError(f"{path}: {error.strerror or error}") from error
    finally:
        os.umask(before)
    listener.settimeout(0)
    return listener


def _peer(link: socket.socket) -> tuple[int, int]:
    """Process and user at the other end."""
    form = struct.Struct("iII")
    process, user, _ = form.unpack(
        link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, form.size)
    )
    return process, user


def _name_of(process: int) -> str:
    with suppress(OSError):
        name = Path(f"/proc/{process}/comm").read_text(errors="replace").strip()
        return f"{shown(name)}[{process}]"  # a process may call itself anything
    return f"[{process}]"
