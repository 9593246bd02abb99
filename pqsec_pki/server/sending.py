"""Sends answers in pieces: one that a client reads slowly is not in memory whole (Twisted)."""

from twisted.internet.interfaces import IPullProducer
from zope.interface import implementer

from pqsec_pki.server.channel import LimitedRequest

PIECE = 64 << 10
"""Octets. A client has the time of a request for each."""


def send(request: LimitedRequest, body: bytes) -> None:
    """Send it after the header that is set, and end the answer."""
    if len(body) > PIECE:
        request.registerProducer(_Pieces(request, body), streaming=False)
        return
    if body:
        request.write(body)
    request.finish()


@implementer(IPullProducer)
class _Pieces:
    """An answer, of which the next piece is sent when the client has taken the last one."""

    def __init__(self, request: LimitedRequest, body: bytes) -> None:
        self._request, self._rest = request, memoryview(body)

    def resumeProducing(self) -> None:  # noqa: N802 -- Twisted's name
        """Send the next piece."""
        piece, self._rest = self._rest[:PIECE], self._rest[PIECE:]
        self._request.channel.begin()
        self._request.write(bytes(piece))
        if not self._rest:
            self._request.unregisterProducer()
            self._request.finish()

    def stopProducing(self) -> None:  # noqa: N802 -- Twisted's name
        """The client has gone."""
        self._rest = memoryview(b"")
