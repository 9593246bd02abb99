"""The agent's sockets: one thread that serves all connections in turn.

Calls take milliseconds, so no process waits long, and shared state needs no lock.
"""

import errno
import os
import resource
import selectors
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin import listening
from pqsec_pki.plugin.agent_folder import AgentFolder
from pqsec_pki.plugin.calls import CONTROL
from pqsec_pki.plugin.connection import AgentContext, Connection, framed, refusal
from pqsec_pki.plugin.notes import Clock, Log, Notes

MAX_CONNECTIONS = 512
"""Connections. A DDS process has two for each domain."""
_AT_ONCE = 1 << 18
"""Octets that are read from one connection in its turn."""
_GRACE_SECONDS = 20.0
"""Seconds that the process that started the agent may take to connect."""
_LONGEST_WAIT = 3600.0
_RESERVE = 32
"""Open files that are reserved for other things than connections."""
_EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_PAUSE = 0.5
"""Seconds until the next try to accept a connection, if the system had no file left."""


class _Client:
    """A connected socket, with the answers that are not sent yet."""

    def __init__(self, link: socket.socket, connection: Connection) -> None:
        self.link, self.connection = link, connection
        self.outbox = bytearray()


class Agent:
    """The agent. It listens until it is stopped, or no process was connected for a while."""

    def __init__(self, place: AgentFolder, idle: float, clock: Clock, log: Log) -> None:
        self._place, self._idle, self._log = place, idle, log
        self._notes = Notes("agent", log, clock)
        self._context = AgentContext(clock, log, self._status, self._stop)
        self._guests: set[_Client] = set()
        self._most = MAX_CONNECTIONS
        self._deaf_until = 0.0
        self._parted = False
        self._stopping = False

    def run(
        self, ready: Callable[[], None] = lambda: None, given: socket.socket | None = None
    ) -> bool:
        """Serve until the end; False if another agent listens there. FileError if it cannot listen.

        `ready` is called when it listens. A `given` socket belongs to systemd, and is not removed.
        """
        self._place.prepare()
        if given:
            self._listen_at(given, ready)
            self._end()
            return True
        with listening.lock(self._place.lock):
            if listening.answers(self._place.socket):
                return False
            listener = listening.bound(self._place.socket)
            own = listening.made(self._place.socket)
        self._listen_at(listener, ready)
        with listening.lock(self._place.lock), suppress(FileNotFoundError):
            if listening.made(self._place.socket) == own:  # and not a later agent's
                self._place.socket.unlink()
        self._end()
        return True

    def _listen_at(self, listener: socket.socket, ready: Callable[[], None]) -> None:
        self._most = min(MAX_CONNECTIONS, max(1, _limited() - _RESERVE))
        ready()
        self._selector = selectors.DefaultSelector()  # which would not survive a fork
        self._selector.register(listener, selectors.EVENT_READ)
        self._log(f"listening at {self._place.socket}")
        with listener:
            self._serve(listener)

    def _end(self) -> None:
        for client in list(self._guests):
            self._part(client)
        self._log("ended")

    def _serve(self, listener: socket.socket) -> None:
        end = time.monotonic() + max(self._idle, _GRACE_SECONDS)
        while not self._stopping and (self._guests or time.monotonic() < end):
            busy = bool(self._guests)
            wait = _LONGEST_WAIT if busy else min(end - time.monotonic(), _LONGEST_WAIT)
            for key, events in self._selector.select(self._listen(listener, wait)):
                if key.fileobj is listener:
                    self._welcome(listener)
                else:
                    self._attend(key.data, events)
            if busy:
                end = time.monotonic() + self._idle
            if self._parted:
                self._parted = False
                _give_back()

    def _listen(self, listener: socket.socket, wait: float) -> float:
        """`wait`, or less if the pause ends before; after the pause, accept connections again."""
        pause = self._deaf_until - time.monotonic()
        if pause > 0:
            return min(pause, wait)
        if self._deaf_until:
            self._deaf_until = 0.0
            self._selector.register(listener, selectors.EVENT_READ)
        return wait

    def _welcome(self, listener: socket.socket) -> None:
        try:
            link, _ = listener.accept()
        except OSError as error:  # it may have gone already
            if error.errno in _EXHAUSTED:
                self._notes.add(f"no more processes can be served: {error.strerror}")
                self._selector.unregister(listener)
                self._deaf_until = time.monotonic() + _PAUSE
            return
        process, user = listening.peer(link)
        link.settimeout(0)
        if user != os.geteuid():
            self._notes.add(f"process {process} of user {user} is not served")
            link.close()
            return
        if len(self._guests) >= self._most:
            why = (
                f"{self._most} connections are the maximum, two for each domain of a DDS process:"
                f" {self._most // 2} processes with one domain each"
            )
            self._notes.add(f"process {process} of user {user} is not served: {why}")
            with suppress(OSError):
                link.send(framed(refusal(f"the agent is full: {why}")))
            link.close()
            return
        client = _Client(link, Connection(self._context, listening.name_of(process)))
        self._guests.add(client)
        self._selector.register(link, selectors.EVENT_READ, client)

    def _attend(self, client: _Client, events: int) -> None:
        try:
            if events & selectors.EVENT_READ:
                self._read(client)
            while client.outbox:
                del client.outbox[: client.link.send(client.outbox)]
        except BlockingIOError:
            pass
        except (OSError, PqsecError) as error:
            if not isinstance(error, ConnectionError):  # closing a connection is not an error
                self._notes.add(f"{client.connection.what[0]}: {error}")
            self._part(client)
            return
        # A process that does not read its answers is not read from, so few answers wait.
        waiting = selectors.EVENT_WRITE if client.outbox else selectors.EVENT_READ
        self._selector.modify(client.link, waiting, client)

    def _read(self, client: _Client) -> None:
        octets = client.link.recv(_AT_ONCE)
        if not octets:
            raise ConnectionResetError
        for answer in client.connection.receive(octets):
            client.outbox += answer

    def _part(self, client: _Client) -> None:
        self._guests.discard(client)
        client.connection.finish()
        self._parted = True
        self._selector.unregister(client.link)
        client.link.close()

    def _status(self) -> dict[str, Any]:
        found = [client.connection.what for client in self._guests]
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


def _give_back() -> None:
    """Return freed memory to the system. glibc would keep it, because it lies between used memory.

    bench/agent_memory.py measures it. Other C libraries have no such function.
    """
    import ctypes  # noqa: PLC0415 -- not for a host that waits for the agent to start

    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _limited() -> int:
    """Disable core files, which would contain keys, and allow files for all connections: how many.

    The priority is reset: a host may have a real-time priority, which the agent must not inherit.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = 2 * MAX_CONNECTIONS
    if 0 <= soft < enough:
        soft = min(enough, hard) if hard >= 0 else enough
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return soft if soft >= 0 else enough
