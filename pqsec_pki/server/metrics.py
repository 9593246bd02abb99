"""Health and metrics of the process that faces the network, for its own machine only."""

from twisted.web.http import HTTPChannel, HTTPFactory, Request

from pqsec_pki.server.call import CallKind, SignerAnswer, SignerCall
from pqsec_pki.server.front import Front
from pqsec_pki.server.limiting import Connections

_OPENMETRICS = "text/plain; version=0.0.4; charset=utf-8"


class StatusRequest(Request):
    """`/healthz`: this process runs. `/readyz`: the signer answers. `/metrics`: counts.

    If changed files cannot be used, the old ones are in force and the server answers as before; the
    last two paths show this.
    """

    def process(self) -> None:
        """Answer it."""
        factory = self.channel.factory
        assert isinstance(factory, StatusPages)  # noqa: S101 -- for the type checker
        if self.path == b"/healthz":
            self.reply(200, b"ok\n")
        elif self.path == b"/metrics":
            self.reply(200, factory.metrics())
        elif self.path == b"/readyz":
            factory.front.calls.ask(SignerCall(kind=CallKind.READY), self._ready)
        else:
            self.reply(404, b"there is nothing here\n")

    def _ready(self, answer: SignerAnswer) -> None:
        if not self._disconnected:
            words = answer.body.decode() or f"{answer.detail}\n"
            said = "".join(f"{each}\n" for each in self.channel.factory.front.troubles)
            self.reply(answer.status, f"{words}{said}".encode())

    def reply(self, status: int, body: bytes) -> None:
        """Write an answer."""
        self.setResponseCode(status)
        self.responseHeaders.setRawHeaders("Content-Type", [_OPENMETRICS])
        self.responseHeaders.setRawHeaders("Content-Length", [str(len(body))])
        self.write(body)
        self.finish()


class _StatusChannel(HTTPChannel):
    requestFactory = StatusRequest  # noqa: N815 -- Twisted's name


class StatusPages(HTTPFactory):
    """The pages, for an address of the machine itself."""

    protocol = _StatusChannel

    def __init__(self, front: Front, connections: Connections) -> None:
        super().__init__(timeout=10)
        self.front, self._connections = front, connections

    def log(self, request: Request) -> None:
        """Write nothing."""

    def metrics(self) -> bytes:
        """The counts, in the text format of Prometheus."""
        lines = [
            "# TYPE pqsec_serve_connections gauge",
            f"pqsec_serve_connections {self._connections.total}",
            "# TYPE pqsec_serve_waiting_calls gauge",
            f"pqsec_serve_waiting_calls {self.front.calls.open}",
            "# TYPE pqsec_serve_configuration_in_force gauge",
            f"pqsec_serve_configuration_in_force {int(not self.front.troubles)}",
            "# TYPE pqsec_serve_events_total counter",
        ]
        lines += [
            f'pqsec_serve_events_total{{event="{name}"}} {count}'
            for name, count in sorted(self.front.counts.items())
        ]
        return "\n".join(lines).encode() + b"\n"
