"""Ports for the servers of tests, which no connection of the machine takes meanwhile.

For port 0 the system chooses one of those that it gives to outgoing connections (from 32768 on
Linux): another connection may take that port again before the server of the test listens.
"""

import os
import socket
from itertools import count

HOST = "127.0.0.1"
FIRST, LAST = 12_000, 32_000

_numbers = count(os.getpid() * 499)
"""Each process begins elsewhere."""


def free_port() -> int:
    """A TCP port at which nothing listens, another one each time."""
    while True:
        port = FIRST + next(_numbers) % (LAST - FIRST)
        with socket.socket() as found:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                found.bind((HOST, port))
            except OSError:
                continue
            return port
