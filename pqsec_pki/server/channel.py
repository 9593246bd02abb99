"""Connections of clients: their number, their memory and the time of each, TLS (Twisted).

The reactor waits for all connections at once, so one that sends nothing takes memory, and no
thread; it is closed when its time is over, whatever it sends by then. If connections or memory
run out, the address that has most of it loses what it has had longest.
"""

from collections.abc import Callable
from io import BytesIO
from typing import Any

from OpenSSL import SSL
from twisted.internet.interfaces import (
    IAddress,
    IDelayedCall,
    IHandshakeListener,
    IOpenSSLServerConnectionCreator,
)
from twisted.internet.protocol import Protocol
from twisted.protocols.policies import WrappingFactory
from twisted.protocols.tls import TLSMemoryBIOFactory
from twisted.web.http import HTTPChannel, HTTPFactory, Request
from zope.interface import implementer

from pqsec_pki.errors import PqsecError
from pqsec_pki.est import peer_certificate, peer_chain, refuse_classical
from pqsec_pki.server.addresses import key_of
from pqsec_pki.server.configuration import ServerLimits
from pqsec_pki.server.limiting import Connections, Shares

_REFUSALS = {
    411: b"Length Required",
    413: b"Content Too Large",
    503: b"Service Unavailable\r\nRetry-After: 10",
}
MOST_HEADERS = 64
"""Lines of the header of a request; each has at most 16 kB, which is Twisted's limit."""
MOST_OCTETS = 24 << 10
"""Octets of all header lines: certificate and signature of an ML-DSA-87 key have 17 kB."""


class LimitedRequest(Request):
    """A request whose body has a known length within the limit, and is not parsed as a form."""

    channel: "LimitedChannel"
    refused = 0
    """The status of a request that is refused before it is complete; its body is not kept."""

    def gotLength(self, length: int | None) -> None:  # noqa: N802 -- Twisted's name
        """Decide by the header whether the body is read."""
        self.content = BytesIO()
        if length is None:
            self.refused = 411
        elif length > self.channel.most(self.channel.path):
            self.refused = 413
        if self.refused:
            self.channel.refuse(self.refused)

    def handleContentChunk(self, data: bytes) -> None:  # noqa: N802
        """Keep the octets, which are at most as many as were announced."""
        if not self.refused:
            super().handleContentChunk(data)
            self.channel.keep(self, len(data))

    def give_up(self) -> None:
        """Refuse it, because others need its memory."""
        self.content, self.refused = BytesIO(), 503
        self.channel.refuse(503)

    def requestReceived(self, command: bytes, path: bytes, version: bytes) -> None:  # noqa: N802
        """Answer it. The path is not decoded, and nothing in the body is parsed here."""
        if self.refused:
            return
        self.content.seek(0)
        self.method, self.uri, self.path, self.clientproto = command, path, path, version
        self.channel.answer(self)


@implementer(IHandshakeListener)
class LimitedChannel(HTTPChannel):
    """A connection with a time for each request, from its first octet, or TLS's, to its last."""

    requestFactory = LimitedRequest  # noqa: N815
    maxHeaders = MOST_HEADERS  # noqa: N815
    totalHeadersSize = MOST_OCTETS  # noqa: N815
    factory: "Channels"
    address = ""
    """The client's address, which behind a balancer is not that of the connection."""
    _deadline: IDelayedCall | None = None

    @property
    def path(self) -> bytes:
        """The path of the request whose header was read last."""
        return bytes(self._path)

    def most(self, path: bytes) -> int:
        """The greatest length of a body that is sent to that path."""
        return self.factory.most(path)

    def answer(self, request: LimitedRequest) -> None:
        """Pass a complete request on."""
        self.factory.answer(request)

    @property
    def connection(self) -> SSL.Connection:
        """The connection of TLS."""
        found: SSL.Connection = self.transport.getHandle()
        return found

    def keep(self, request: LimitedRequest, octets: int) -> None:
        """So many octets more of an incomplete request are in memory."""
        self.factory.keep(key_of(self.address), request, octets)

    def peer(self) -> bytes:
        """The client's certificate, whose key it has shown to have, in DER; empty for none.

        MalformedError for one that pqsec does not read.
        """
        found = peer_certificate(self.connection)
        return found.der if found else b""

    def peer_chain(self) -> tuple[bytes, ...]:
        """The CAs that the client sent with its certificate, in DER; nothing of it is verified."""
        return peer_chain(self.connection)

    def connectionMade(self) -> None:  # noqa: N802
        """Begin the time of the first request, with the handshake of TLS."""
        super().connectionMade()
        self.begin()

    def handshakeCompleted(self) -> None:  # noqa: N802
        """Close a connection without post-quantum key agreement, unless those are allowed."""
        if self.factory.classical:
            return
        try:
            refuse_classical(self.transport.getHandle())
        except PqsecError:
            self.factory.count("classical")
            self.transport.abortConnection()

    def refuse(self, status: int) -> None:
        """Answer a request whose body is not read, and close."""
        self.factory.count(f"refused-{status}")
        words = _REFUSALS[status]
        head = b"HTTP/1.1 %d %s\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        self.transport.write(head % (status, words))
        self.loseConnection()

    def allContentReceived(self) -> None:  # noqa: N802
        """The request came in time; a refused one has no answer that could begin the next time."""
        request = self.requests[-1]
        self.factory.kept.remove(key_of(self.address), request)
        if not request.refused:
            self._end()
        super().allContentReceived()

    def lineLengthExceeded(self, line: bytes) -> None:  # noqa: N802
        """Close the connection now: Twisted's own way waits until its time is over."""
        del line
        self.loseConnection()

    def requestDone(self, request: Request) -> None:  # noqa: N802
        """Begin the time of the next one."""
        self.begin()
        super().requestDone(request)

    def connectionLost(self, reason: Any) -> None:  # noqa: N802
        """The connection is closed."""
        self._end()
        for each in self.requests:
            self.factory.kept.remove(key_of(self.address), each)
        super().connectionLost(reason)

    def begin(self) -> None:
        """Begin a time in which the client has to do something: to send, or to read."""
        self._end()
        self._deadline = self.factory.reactor.callLater(self.factory.seconds, self._late)
        self.factory.connections.idle(self.transport)

    def _end(self) -> None:
        if self._deadline is not None and self._deadline.active():
            self._deadline.cancel()
        self._deadline = None
        self.factory.connections.busy(self.transport)

    def _late(self) -> None:
        self.factory.count("late")
        self.transport.abortConnection()


class Channels(HTTPFactory):
    """Makes a channel of each connection."""

    protocol = LimitedChannel

    def __init__(  # noqa: PLR0913 -- by name
        self,
        reactor: Any,
        *,
        seconds: int,
        classical: bool,
        buffered: int,
        connections: Connections,
        most: Callable[[bytes], int],
        answer: Callable[[LimitedRequest], None],
        count: Callable[[str], None],
    ) -> None:
        super().__init__(timeout=None, reactor=reactor)  # our own time does not begin again
        self.seconds, self.classical, self.buffered = seconds, classical, buffered
        self.connections, self.kept = connections, Shares()
        self.most, self.answer, self.count = most, answer, count

    def use(self, limits: ServerLimits) -> None:
        """Apply these limits from now on."""
        self.seconds, self.buffered = limits.seconds, limits.buffered
        self.connections.use(limits)

    def buildProtocol(self, addr: IAddress | None) -> Protocol | None:  # noqa: N802
        """The channel of a client with that address."""
        made = super().buildProtocol(addr)
        made.address = str(getattr(addr, "host", ""))
        return made

    def keep(self, key: str, request: LimitedRequest, octets: int) -> None:
        """Count octets of an incomplete request; if all have too many, refuse one of them."""
        self.kept.add(key, request, octets)
        while self.kept.total > self.buffered:
            self.kept.to_give_up().give_up()

    def log(self, request: Request) -> None:
        """Write nothing: the code that answers writes the log."""


class CountedChannels(WrappingFactory):
    """Channels, as many as are allowed."""

    channels: Channels

    def buildProtocol(self, addr: IAddress | None) -> Protocol | None:  # noqa: N802
        """The connection's protocol; None closes it."""
        address = key_of(str(getattr(addr, "host", "")))
        if not self.channels.connections.admits(address):
            self.channels.count("too-many")
            return None
        if not self.has_room():
            return None
        self.channels.count("connections")
        made: Protocol = super().buildProtocol(addr)
        self.channels.connections.opened(made, address)
        return made

    def has_room(self) -> bool:
        """Whether one more may be open, after one was closed for it if need be."""
        connections = self.channels.connections
        if connections.total < connections.limits.connections:
            return True
        found = connections.to_close()
        self.channels.count("too-many" if found is None else "closed-for-others")
        if found is not None:
            found.abortConnection()
        return found is not None

    def unregisterProtocol(self, p: Any) -> None:  # noqa: N802
        """One connection less."""
        super().unregisterProtocol(p)
        self.channels.connections.closed(p)


class PlainChannels(CountedChannels):
    """Channels without TLS, for an address of the machine itself."""

    def __init__(self, channels: Channels) -> None:
        self.channels = channels
        super().__init__(channels)


class TlsChannels(CountedChannels, TLSMemoryBIOFactory):
    """Channels below TLS."""

    def __init__(
        self, context: Callable[[], SSL.Context], channels: Channels, reactor: Any
    ) -> None:
        self.channels = channels
        TLSMemoryBIOFactory.__init__(
            self, _Contexts(context), isClient=False, wrappedFactory=channels, clock=reactor
        )


@implementer(IOpenSSLServerConnectionCreator)
class _Contexts:
    """Gives each connection the newest context: a new certificate needs no new start."""

    def __init__(self, context: Callable[[], SSL.Context]) -> None:
        self._context = context

    def serverConnectionForTLS(self, protocol: Any) -> SSL.Connection:  # noqa: N802
        """A connection that reads and writes memory."""
        del protocol
        return SSL.Connection(self._context(), None)
