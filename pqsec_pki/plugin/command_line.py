"""Connections of `pqsec agent`, which the agent answers itself.

An answer waits until the workers have counted their objects.
"""

import selectors
import socket
import time
from collections.abc import Callable

from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin.calls import CONTROL
from pqsec_pki.plugin.connection import GREETED, AgentContext, Connection
from pqsec_pki.plugin.incoming import IncomingConnection
from pqsec_pki.plugin.worker import OpenConnection
from pqsec_pki.plugin.workers import Workers

_ANSWER_SECONDS = 1.0
"""Seconds that workers may take to count their objects; else their former answer is shown."""


class CommandLine:
    """The connections of the command line."""

    def __init__(
        self,
        context: AgentContext,
        selector: selectors.BaseSelector,
        workers: Workers,
        note: Callable[[str], None],
    ) -> None:
        self._context, self._selector = context, selector
        self._workers, self._note = workers, note
        self._clients: dict[OpenConnection, float] = {}
        """Until when each waits for workers; 0 if it does not."""

    def __len__(self) -> int:
        return len(self._clients)

    @property
    def links(self) -> list[socket.socket]:
        """Their sockets."""
        return [each.link for each in self._clients]

    @property
    def due(self) -> list[float]:
        """When `answer` has something to do, for each client that waits."""
        waiting = [until for until in self._clients.values() if until]
        return [0.0] * len(waiting) if self._workers.has_answered else waiting

    def serve(self, incoming: IncomingConnection) -> None:
        """Answer the calls of a client that has greeted."""
        connection = Connection(self._context, incoming.who, CONTROL)
        client = OpenConnection(incoming.link, connection, self._attend)
        client.outbox += GREETED
        self._clients[client] = 0.0
        self._attend(client, 0)

    def answer(self) -> None:
        """Answer those that wait, when the workers have answered or take too long."""
        now = time.monotonic()
        for client, until in list(self._clients.items()):
            if until and (self._workers.has_answered or now >= until):
                self._clients[client] = 0.0
                client.outbox += client.connection.answer()
                self._attend(client, 0)

    def _attend(self, client: OpenConnection, events: int) -> None:
        try:
            client.exchange(events)
            if not client.outbox and client.connection.waits:
                self._workers.ask()
                self._clients[client] = time.monotonic() + _ANSWER_SECONDS
            # A process that does not read its answers is not read from, so few answers wait.
            waiting = selectors.EVENT_WRITE if client.outbox else selectors.EVENT_READ
            events = 0 if self._clients[client] else waiting
            client.watch(self._selector, events)
        except (OSError, PqsecError) as error:
            if not isinstance(error, ConnectionError):
                self._note(f"{client.connection.what[0]}: {error}")
            del self._clients[client]
            client.close(self._selector)
