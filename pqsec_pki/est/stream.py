"""A TLS connection to a server, in the form that http.client needs, with a deadline."""

import io
import select
import socket
import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from OpenSSL import SSL

from pqsec_pki.est.tls import refuse_classical

Result = TypeVar("Result")

_PIECE = 16 << 10
"""Bytes: as many as a record of TLS has."""


class TlsStream:
    """A connection whose every wait ends at a deadline, with TimeoutError.

    So a server that sends one byte after another cannot delay its client for longer.
    """

    def __init__(self, connected: socket.socket, context: SSL.Context, host: str) -> None:
        connected.settimeout(0)
        self._socket = connected
        self._tls = SSL.Connection(context, connected)
        if not _is_address(host):
            self._tls.set_tlsext_host_name(host.encode("idna"))
        self._tls.set_connect_state()
        self._until = time.monotonic()

    def allow(self, seconds: float) -> None:
        """Set the deadline: in so many seconds."""
        self._until = time.monotonic() + seconds

    def handshake(self, *, classical: bool) -> None:
        """Agree on keys. VerificationError for a server that is not trusted, or not GROUP."""
        self._waiting(self._tls.do_handshake)
        if not classical:
            refuse_classical(self._tls)

    @property
    def connection(self) -> SSL.Connection:
        """The connection of TLS."""
        return self._tls

    def sendall(self, data: bytes) -> None:
        """Send all of `data`."""
        while data:
            piece = data[:_PIECE]
            data = data[self._waiting(partial(self._tls.send, piece)) :]

    def recv(self, size: int) -> bytes:
        """Up to `size` bytes; none if the server closed the connection in order."""
        try:
            return self._waiting(partial(self._tls.recv, size))
        except SSL.ZeroReturnError:
            return b""

    def makefile(self, mode: str) -> io.BufferedReader:
        """The bytes that come, as http.client reads them."""
        assert mode == "rb"  # noqa: S101 -- http.client asks for nothing else
        return io.BufferedReader(_Incoming(self))

    def close(self) -> None:
        """Nothing: http.client closes before it has read the answer. See `end`."""

    def end(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _waiting(self, call: Callable[[], Result]) -> Result:
        while True:
            self._left()
            try:
                return call()
            except SSL.WantReadError:
                self._wait(select.POLLIN)
            except SSL.WantWriteError:
                self._wait(select.POLLOUT)

    def _wait(self, event: int) -> None:
        left = self._left()
        poll = select.poll()
        poll.register(self._socket, event)
        poll.poll(left * 1000)

    def _left(self) -> float:
        """The seconds that are left. TimeoutError for none, also if there is always more to read.

        http.client reads interim answers, chunks and trailers without a limit of its own.
        """
        left = self._until - time.monotonic()
        if left <= 0:
            raise TimeoutError("it takes too long")
        return left


class _Incoming(io.RawIOBase):
    """A stream of the octets that a server sends."""

    def __init__(self, stream: TlsStream) -> None:
        self._stream = stream

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer)
        data = self._stream.recv(min(len(view), _PIECE))
        view[: len(data)] = data
        return len(data)


def _is_address(host: str) -> bool:
    return ":" in host or host.replace(".", "").isdecimal()
