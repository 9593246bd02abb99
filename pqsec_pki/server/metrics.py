"""Health and metrics of the process that faces the network, for its own machine only."""

from pqsec_pki.server.addresses import key_of
from pqsec_pki.server.call import CallKind, SignerAnswer, SignerCall
from pqsec_pki.server.channel import LimitedRequest
from pqsec_pki.server.configuration import ServerLimits
from pqsec_pki.server.front import Front
from pqsec_pki.server.limiting import Connections, Rate
from pqsec_pki.server.sending import send

_OPENMETRICS = "text/plain; version=0.0.4; charset=utf-8"
_TOO_MANY = 429


class StatusPages:
    """`/healthz`: this process runs. `/readyz`: the signer answers. `/metrics`: counts.

    If changed files cannot be used, the old ones are in force and the server answers as before; the
    last two paths show this. Clients have limits of their own, as many as those of robots, so that
    neither displaces the other.
    """

    def __init__(self, front: Front, connections: Connections) -> None:
        self._front, self._connections = front, connections
        self.use(front.limits.of_status)

    def use(self, limits: ServerLimits) -> None:
        """Apply these limits from now on."""
        self._often = Rate(limits.requests_of_address)

    def count(self, what: str) -> None:
        """Count an event of a connection for these pages."""
        self._front.count(f"status-address-{what}")

    def answer(self, request: LimitedRequest) -> None:
        """Answer the request, now or when the signer has."""
        address = request.channel.address
        if wait := self._often.wait(key_of(address)):
            request.channel.persistent = False  # what else it sent is not looked at
            request.responseHeaders.setRawHeaders("Retry-After", [str(wait)])
            _reply(request, _TOO_MANY, b"too many requests: ask later\n")
        elif request.path == b"/healthz":
            _reply(request, 200, b"ok\n")
        elif request.path == b"/metrics":
            _reply(request, 200, self._metrics())
        elif request.path == b"/readyz":
            call = SignerCall(kind=CallKind.READY, address=address)
            self._front.calls.ask(call, lambda answer: self._ready(request, answer))
        else:
            _reply(request, 404, b"there is nothing here\n")

    def _ready(self, request: LimitedRequest, answer: SignerAnswer) -> None:
        words = answer.body.decode() or f"{answer.detail}\n"
        said = "".join(f"{each}\n" for each in self._front.troubles)
        _reply(request, answer.status, f"{words}{said}".encode())

    def _metrics(self) -> bytes:
        """The counts, in the text format of Prometheus."""
        lines = [
            "# TYPE pqsec_serve_connections gauge",
            f"pqsec_serve_connections {self._connections.total}",
            "# TYPE pqsec_serve_waiting_calls gauge",
            f"pqsec_serve_waiting_calls {self._front.calls.open}",
            "# TYPE pqsec_serve_configuration_in_force gauge",
            f"pqsec_serve_configuration_in_force {int(not self._front.troubles)}",
            "# TYPE pqsec_serve_events_total counter",
        ]
        lines += [
            f'pqsec_serve_events_total{{event="{name}"}} {count}'
            for name, count in sorted(self._front.counts.items())
        ]
        return "\n".join(lines).encode() + b"\n"


def _reply(request: LimitedRequest, status: int, body: bytes) -> None:
    """Write an answer, unless the client has gone."""
    if request._disconnected:  # noqa: SLF001 -- Twisted has no other way to ask
        return
    request.setResponseCode(status)
    request.responseHeaders.setRawHeaders("Content-Type", [_OPENMETRICS])
    request.responseHeaders.setRawHeaders("Content-Length", [str(len(body))])
    send(request, body)
