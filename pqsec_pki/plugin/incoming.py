"""A process that has connected to the agent and has not sent its greeting yet."""

import socket
from contextlib import suppress

from pqsec_pki.plugin import listening
from pqsec_pki.plugin.connection import framed, missing, refusal
from pqsec_pki.plugin.greeting import Greeting

MAX_GREETING = 16 << 10
"""Octets: two paths and more."""


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


def refuse(link: socket.socket, words: str) -> None:
    """Send the reason why the process is not served, and close the connection."""
    with link, suppress(OSError):
        link.send(framed(refusal(words)))
