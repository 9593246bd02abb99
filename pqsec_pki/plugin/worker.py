"""A worker of the agent: a process that serves connections, and holds their keys.

A worker has everything that its connections need, and shares only revocation lists with other
workers (`shared_lists.py`). It serves one call at a time. Calls that create participants come
before calls of handshakes. A process whose call waits gets an empty frame each second.
"""

import selectors
import socket
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import field
from functools import partial

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin import channel
from pqsec_pki.plugin.calls import WORKING
from pqsec_pki.plugin.connection import AgentContext, Connection
from pqsec_pki.plugin.lists import NewestLists
from pqsec_pki.plugin.notes import Clock, Log, Notes
from pqsec_pki.plugin.octets import MessageReader
from pqsec_pki.plugin.shared_lists import exchange_through
from pqsec_pki.plugin.system import give_back

_AT_ONCE = 1 << 18
"""Octets that are read from one connection in its turn."""
FAIR = 8
"""Other calls before one of a handshake, so that no process can block handshakes."""
TELL_SECONDS = 1.0
"""Seconds between two frames that say that the worker works."""


@dataclass(slots=True, eq=False)
class OpenConnection:
    """A connected socket, with the answers that are not sent yet."""

    link: socket.socket
    connection: Connection
    attend: Callable[["OpenConnection", int], None]
    """The function that is called with these events of its socket."""
    number: int = 0
    outbox: bytearray = field(default_factory=bytearray)
    events: int = 0
    """The events that the selector watches its socket for."""

    def exchange(self, events: int) -> None:
        """Keep what came, and send what fits. OSError if the other end has gone."""
        if events & selectors.EVENT_READ:
            octets = self.link.recv(_AT_ONCE)
            if not octets:
                raise ConnectionResetError
            self.connection.hear(octets)
        self.flush()

    def flush(self) -> None:
        """Send what fits. OSError if the other end has gone."""
        with suppress(BlockingIOError):
            while self.outbox:
                del self.outbox[: self.link.send(self.outbox)]

    def watch(self, selector: selectors.BaseSelector, events: int) -> None:
        """Let `selector` watch its socket for these events, or not at all if 0."""
        if events and self.events:
            selector.modify(self.link, events, partial(self.attend, self))
        elif events:
            selector.register(self.link, events, partial(self.attend, self))
        elif self.events:
            selector.unregister(self.link)
        self.events = events

    def close(self, selector: selectors.BaseSelector) -> None:
        """Close the connection and forget its objects."""
        self.watch(selector, 0)
        self.connection.finish()
        self.link.close()


class AgentWorker:
    """Serves the connections that the agent hands over, until the agent has gone."""

    def __init__(self, orders: socket.socket, lists: socket.socket, clock: Clock, log: Log) -> None:
        self._orders = orders
        self._context = AgentContext(
            clock, log, dict, lambda: None, lists=NewestLists(exchange_through(lists))
        )
        self._notes = Notes("agent", log, clock)
        self._clients: dict[int, OpenConnection] = {}
        self._first: deque[OpenConnection] = deque()
        self._handshakes: deque[OpenConnection] = deque()
        self._since_handshake = 0
        self._has_closed = self._ended = False
        self._reported_at = time.monotonic()
        self._selector = selectors.DefaultSelector()

    def run(self) -> None:
        """Return when the agent closes its end."""
        self._selector.register(self._orders, selectors.EVENT_READ, self._read_order)
        while not self._ended:
            busy = bool(self._first or self._handshakes)
            for key, events in self._selector.select(0 if busy else None):
                key.data(events)
            if client := self._next():
                self._serve(client)
            self._report_working()
            if self._has_closed and not (self._first or self._handshakes):
                self._has_closed = False
                give_back()
        for client in list(self._clients.values()):
            self._close(client)

    def _read_order(self, _: int) -> None:
        """Read a message of the agent: a new connection, or the question for the objects."""
        found = channel.take(self._orders)
        if found is None:
            self._ended = True
            return
        reader, handle = found
        if reader.text() != channel.SERVE:
            self._count()
        elif handle is not None:
            self._accept(reader, handle)
        else:  # the system had no file left for it
            self._say_gone(reader.number("I"))

    def _accept(self, reader: MessageReader, handle: int) -> None:
        number, plugin, who = reader.number("I"), reader.text(), reader.text()
        link = socket.socket(fileno=handle)
        link.settimeout(0)
        client = OpenConnection(link, Connection(self._context, who, plugin), self._attend, number)
        self._clients[number] = client
        client.watch(self._selector, selectors.EVENT_READ)

    def _count(self) -> None:
        """Tell the agent how many objects each connection has."""
        answer = channel.message(channel.STATUS)
        answer.number("I", len(self._clients))
        for number, client in self._clients.items():
            answer.number("I", number)
            answer.number("I", client.connection.what[2])
        with suppress(OSError):
            channel.put(self._orders, answer)

    def _attend(self, client: OpenConnection, events: int) -> None:
        try:
            client.exchange(events)
            self._queue(client)
        except BlockingIOError:
            pass
        except (OSError, PqsecError) as error:
            self._lost(client, error)

    def _queue(self, client: OpenConnection) -> None:
        """Append it to its queue, if a whole frame waits.

        A process that does not read its answers is not read from, so few answers wait.
        """
        if client.outbox:
            client.watch(self._selector, selectors.EVENT_WRITE)
        elif not client.connection.waits:
            client.watch(self._selector, selectors.EVENT_READ)
        else:
            client.watch(self._selector, 0)
            later = client.connection.waits_for_handshake
            (self._handshakes if later else self._first).append(client)

    def _next(self) -> OpenConnection | None:
        """The connection whose call is next."""
        if self._first and (self._since_handshake < FAIR or not self._handshakes):
            self._since_handshake += 1
            return self._first.popleft()
        self._since_handshake = 0
        return self._handshakes.popleft() if self._handshakes else None

    def _serve(self, client: OpenConnection) -> None:
        try:
            client.outbox += client.connection.answer()
            client.flush()
            self._queue(client)
        except (OSError, PqsecError) as error:
            self._lost(client, error)

    def _report_working(self) -> None:
        """Tell the processes whose calls wait that the worker works."""
        now = time.monotonic()
        if now < self._reported_at + TELL_SECONDS:
            return
        self._reported_at = now
        for client in (*self._first, *self._handshakes):
            with suppress(OSError):  # its turn will show the error
                client.link.send(WORKING)

    def _lost(self, client: OpenConnection, error: Exception) -> None:
        if not isinstance(error, ConnectionError):  # closing a connection is not an error
            self._notes.add(f"{client.connection.what[0]}: {error}")
        self._close(client)
        self._say_gone(client.number)

    def _say_gone(self, number: int) -> None:
        gone = channel.message(channel.GONE)
        gone.number("I", number)
        with suppress(OSError):  # the agent has ended
            channel.put(self._orders, gone)

    def _close(self, client: OpenConnection) -> None:
        del self._clients[client.number]
        self._has_closed = True
        client.close(self._selector)
