"""Processes that have connected to the agent and have not sent their greetings yet."""

import selectors
import socket
import time
from collections.abc import Callable
from contextlib import suppress

from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin import listening
from pqsec_pki.plugin.connection import framed, missing, refusal
from pqsec_pki.plugin.greeting import Greeting, VersionError

MAX_GREETING = 16 << 10
"""Octets: two paths and more."""
_STARTER_SECONDS = 2.0
"""Seconds in which the agent reads the greeting of the process that started it first. A process
served before it could use the rights of its groups; one that the agent cannot serve could end the
agent."""


class IncomingConnection:
    """A connection of which only the greeting is read."""

    def __init__(self, link: socket.socket, process: int) -> None:
        self.link, self.process, self.who = link, process, listening.name_of(process)
        self._inbox = bytearray()

    def greeting(self) -> Greeting | None:
        """Its greeting; None as long as that is not complete.

        OSError if the process has ended, PqsecError if its octets are not a greeting.
        """
        octets = self.link.recv(missing(self._inbox, MAX_GREETING))
        if not octets:
            raise ConnectionResetError
        self._inbox += octets
        is_part = missing(self._inbox, MAX_GREETING)
        return None if is_part else Greeting.read(bytes(self._inbox[4:]))


class IncomingConnections:
    """The connections that the agent accepted, each until its greeting is read.

    `greeted` gets the greeting, or the error of one in another version. With `starter`, the host
    that started the agent, the others are read after its greeting, or when that is overdue.
    """

    def __init__(
        self,
        selector: selectors.BaseSelector,
        starter: int | None,
        greeted: Callable[[IncomingConnection, Greeting | VersionError], None],
        note: Callable[[str], None],
    ) -> None:
        self._selector, self._starter = selector, starter
        self._greeted, self._note = greeted, note
        self._all: set[IncomingConnection] = set()
        self._deferred: list[IncomingConnection] = []
        """Of these, the ones that are read after the starter."""
        self.starter_until = 0.0 if starter is None else time.monotonic() + _STARTER_SECONDS
        """The time until which only the starter is read; 0 if all are."""

    def __len__(self) -> int:
        return len(self._all)

    @property
    def links(self) -> list[socket.socket]:
        """Their sockets."""
        return [each.link for each in self._all]

    def add(self, incoming: IncomingConnection) -> None:
        """Read its greeting when it comes."""
        self._all.add(incoming)
        if self.starter_until and incoming.process != self._starter:
            self._deferred.append(incoming)
        else:
            self._watch(incoming)

    def read_deferred(self) -> None:
        """Read the others: the greeting of the host that started the agent is read, or overdue."""
        deferred, self._deferred, self.starter_until = self._deferred, [], 0.0
        for each in deferred:
            self._watch(each)

    def _watch(self, incoming: IncomingConnection) -> None:
        self._selector.register(incoming.link, selectors.EVENT_READ, lambda _: self._read(incoming))

    def _read(self, incoming: IncomingConnection) -> None:
        greeting: Greeting | VersionError | None
        try:
            greeting = incoming.greeting()
            if not greeting:
                return
        except BlockingIOError:
            return
        except VersionError as error:
            greeting = error
        except (OSError, PqsecError) as error:
            if not isinstance(error, ConnectionError):  # closing a connection is not an error
                self._note(f"{incoming.who}: {error}")
            greeting = None
        self._selector.unregister(incoming.link)
        if greeting:
            self._greeted(incoming, greeting)
        else:
            incoming.link.close()
        self._all.discard(incoming)
        if self.starter_until and incoming.process == self._starter:
            self.read_deferred()


def refuse(link: socket.socket, words: str) -> None:
    """Send the reason why the process is not served, and close the connection."""
    with link, suppress(OSError):
        link.send(framed(refusal(words)))
