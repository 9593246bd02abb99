"""Connections of TCP balancers: a PROXY header before TLS has the client's address (Twisted).

Connections from configured addresses must begin with a header; on others it is not read.
"""

from collections.abc import Iterable
from typing import Any

from twisted.internet.address import IPv4Address, IPv6Address
from twisted.internet.interfaces import IAddress, IDelayedCall
from twisted.internet.protocol import Protocol, connectionDone
from twisted.protocols.policies import WrappingFactory
from twisted.python.failure import Failure

from pqsec_pki.errors import MalformedError
from pqsec_pki.server.addresses import Network, is_in, key_of
from pqsec_pki.server.channel import Channels, TlsChannels
from pqsec_pki.server.events import Log
from pqsec_pki.server.proxy_header import ProxyHeader


class BalancerLink(Protocol):
    """A connection of a balancer before TLS, which becomes the client's when its header is read."""

    def __init__(self, owner: "ClientsOfBalancers", address: str) -> None:
        self._owner, self.address, self._got = owner, address, b""
        self._deadline: IDelayedCall | None = None

    def connectionMade(self) -> None:  # noqa: N802 -- Twisted's name
        """Begin the time of the header."""
        channels = self._owner.channels
        self._deadline = channels.reactor.callLater(channels.seconds, self._late)

    def dataReceived(self, data: bytes) -> None:  # noqa: N802
        """Read the header, and pass on what follows."""
        self._got += data
        try:
            header = ProxyHeader.of(self._got)
        except MalformedError as error:
            self._owner.refused(self, str(error))
            self.abortConnection()
            return
        if header is None:
            return
        self._end()
        made = self._owner.client_of(header.client or self.address)
        if made is None:
            self.abortConnection()
            return
        self.transport.protocol = made  # as Twisted does where a connection begins TLS
        made.makeConnection(self.transport)
        if rest := self._got[header.length :]:
            made.dataReceived(rest)

    def connectionLost(self, reason: Failure = connectionDone) -> None:  # noqa: N802
        """End its time limit: it was closed before its header was complete."""
        del reason
        self._end()

    def abortConnection(self) -> None:  # noqa: N802 -- as connections of TLS
        """Close it now."""
        self.transport.abortConnection()

    def _end(self) -> None:
        """Stop counting it as a connection of the balancer."""
        if self._deadline is not None and self._deadline.active():
            self._deadline.cancel()
        self._owner.channels.connections.closed(self)

    def _late(self) -> None:
        self._owner.channels.count("late")
        self.abortConnection()


class ClientsOfBalancers(WrappingFactory):
    """Connections of balancers in these networks, and of all other clients."""

    def __init__(self, tls: TlsChannels, networks: Iterable[Network], log: Log) -> None:
        super().__init__(tls)
        self._tls, self.networks, self._log = tls, tuple(networks), log

    @property
    def channels(self) -> Channels:
        """The channels below TLS."""
        return self._tls.channels

    def buildProtocol(self, addr: IAddress | None) -> Any:  # noqa: N802
        """The connection's protocol; None closes it."""
        address = str(getattr(addr, "host", ""))
        if not is_in(address, self.networks):
            return self._tls.buildProtocol(addr)
        if not self._tls.has_room():
            return None
        made = BalancerLink(self, address)
        self.channels.connections.opened(made, key_of(address))
        self.channels.connections.idle(made)
        return made

    def client_of(self, address: str) -> Protocol | None:
        """The protocol of a client with that address; None closes the connection."""
        kind = IPv6Address if ":" in address else IPv4Address
        return self._tls.buildProtocol(kind("TCP", address, 0))

    def refused(self, link: BalancerLink, detail: str) -> None:
        """Log that a balancer did not send a valid header."""
        self.channels.count("proxy-header")
        self._log({"event": "a balancer is refused", "address": link.address, "detail": detail})
