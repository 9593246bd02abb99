"""Asks the signer from the process that faces the network, without waiting (Twisted).

Calls that the signer cannot take yet wait here. Addresses take turns; beyond the limit, the oldest
call of the address with most is refused. So attackers cannot block robots' calls.
"""

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twisted.internet.interfaces import IDelayedCall
from twisted.internet.protocol import ClientFactory, Protocol

from pqsec_pki.errors import MalformedError
from pqsec_pki.server.addresses import key_of
from pqsec_pki.server.call import CallKind, SignerAnswer, SignerCall, length_of, unpacked
from pqsec_pki.server.limiting import Shares

SECONDS = 60.0
"""Until the answer: the signer may wait half a minute for another command at the keystore."""
MOST_OPEN = 256
"""Calls that wait for the signer, here or there."""
MOST_SENT = 128
"""Calls at the signer: those that it answers together now, and the next."""
_OCTETS = 64 << 10
"""A call with a longer body counts as several: 16 receipts would else be all that may wait."""
KEPT_SECONDS = 5.0
"""How long an answer that is the same for everybody is given again."""
_SHARED = frozenset(
    {
        CallKind.CA_CERTIFICATES,
        CallKind.REQUEST_ATTRIBUTES,
        CallKind.REVOCATION_LIST,
        CallKind.HEAD,
    }
)
_BUSY = SignerAnswer(status=503, retry_after=10, detail="the server is busy: ask again")
_GONE = SignerAnswer(status=503, retry_after=10, detail="the signer does not answer: ask again")

Then = Callable[[SignerAnswer], None]


class SignerCalls:
    """The calls that wait for the signer, and answers that are kept for a moment."""

    def __init__(self, reactor: Any, socket: Path) -> None:
        self._reactor, self._socket = reactor, str(socket)
        self.open = self._sent = 0
        self._waiting = Shares()
        self.trouble = ""
        """The last error in its configuration that the signer reported."""
        self._kept: OrderedDict[CallKind, tuple[float, SignerAnswer]] = OrderedDict()

    def ask(self, call: SignerCall, then: Then) -> None:
        """Call `then` once with the answer; one of status 503 if there is none."""
        if call.kind in _SHARED and (kept := self._kept.get(call.kind)):
            at, answer = kept
            if self._reactor.seconds() - at < KEPT_SECONDS:
                then(answer)
                return
        self.open += 1

        def finish(answer: SignerAnswer) -> None:
            self._end(asked)
            if answer is not _BUSY:
                self.trouble = answer.trouble
            if call.kind in _SHARED and answer.status == 200:  # noqa: PLR2004
                self._kept[call.kind] = (self._reactor.seconds(), answer)
            then(answer)

        asked = _Factory(self._reactor, call, finish)
        self._waiting.add(key_of(call.address), asked, asked.size)
        while self._waiting.total + self._sent > MOST_OPEN:
            self._waiting.to_give_up().finish(_BUSY)
        self._send()

    def _send(self) -> None:
        while self._sent < MOST_SENT and (asked := self._waiting.in_turn()):
            self._sent += asked.size
            asked.sent = True
            self._reactor.connectUNIX(self._socket, asked, timeout=5)

    def _end(self, asked: "_Factory") -> None:
        """End an answered call, and send the next."""
        self.open -= 1
        self._sent -= asked.size * asked.sent
        self._waiting.remove(key_of(asked.call.address), asked)
        self._send()


class _Factory(ClientFactory):
    """One call."""

    noisy = False
    sent = False

    def __init__(self, reactor: Any, call: SignerCall, then: Then) -> None:
        self.call, self._then = call, then
        self.size = max(1, -(-len(call.body) // _OCTETS))
        self._limit: IDelayedCall = reactor.callLater(SECONDS, self.finish, _GONE)

    def finish(self, answer: SignerAnswer) -> None:
        """Pass the first answer on; later ones are ignored."""
        then, self._then = self._then, _ignored
        if self._limit.active():
            self._limit.cancel()
        then(answer)

    def buildProtocol(self, addr: Any) -> Protocol:  # noqa: N802 -- Twisted's name
        """The connection."""
        del addr
        made = _Connection()
        made.factory = self
        return made

    def clientConnectionFailed(self, connector: Any, reason: Any) -> None:  # noqa: N802
        """The signer does not listen."""
        del connector, reason
        self.finish(_GONE)


class _Connection(Protocol):
    factory: _Factory

    def __init__(self) -> None:
        self._received = bytearray()

    def connectionMade(self) -> None:  # noqa: N802
        """Send the call."""
        self.transport.write(self.factory.call.to_bytes())

    def dataReceived(self, data: bytes) -> None:  # noqa: N802
        """Collect the answer."""
        self._received += data
        size = length_of(bytes(self._received[:8]))
        if size is not None and len(self._received) >= size:
            self._finish()

    def connectionLost(self, reason: Any = None) -> None:  # noqa: N802
        """Without a whole answer there is none."""
        del reason
        self.factory.finish(_GONE)

    def _finish(self) -> None:
        rest = memoryview(bytes(self._received))

        def take(size: int) -> bytes:
            nonlocal rest
            found, rest = bytes(rest[:size]), rest[size:]
            return found

        try:
            answer = SignerAnswer.of(*unpacked(take))
        except MalformedError:
            answer = _GONE
        self.factory.finish(answer)
        self.transport.loseConnection()


def _ignored(_answer: SignerAnswer) -> None:
    return
