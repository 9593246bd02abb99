"""The process that faces the network: its sockets, its signals, and its end (Twisted)."""

import os
import resource
import signal
from collections.abc import Callable
from contextlib import suppress
from socket import socket
from typing import Any

from OpenSSL import SSL
from twisted.internet import reactor as _reactor
from twisted.logger import globalLogBeginner

from pqsec_pki._files import read
from pqsec_pki.errors import PqsecError, located
from pqsec_pki.est import TlsIdentity, server_context
from pqsec_pki.server.asking import SignerCalls
from pqsec_pki.server.balancing import ClientsOfBalancers
from pqsec_pki.server.channel import Channels, LimitedRequest, PlainChannels, TlsChannels
from pqsec_pki.server.configuration import ServerLimits, ServerSettings, read_settings
from pqsec_pki.server.events import log
from pqsec_pki.server.front import Front
from pqsec_pki.server.limiting import Connections
from pqsec_pki.server.metrics import StatusPages
from pqsec_pki.server.running import bound, end_with_signer, given_sockets, notify, stay
from pqsec_pki.server.state_folder import refuse_open_front

reactor: Any = _reactor
_GRACE = 5.0
"""Seconds for open answers after SIGTERM."""


def tls_context(settings: ServerSettings) -> SSL.Context:
    """The context of the configured certificates; PqsecError names the file at fault."""
    identities = []
    for each in settings.tls:
        with located(each.chain):
            identities.append(TlsIdentity.of(read(each.chain), read(each.key)))
    return server_context(identities, classical=settings.classical)


class Listening:
    """The listening sockets, and what is behind them."""

    def __init__(self, settings: ServerSettings) -> None:
        self._settings, self._context = settings, tls_context(settings)
        self.front = Front(SignerCalls(reactor, settings.socket), settings.limits, log)
        limits = settings.limits
        self._channels = self._made(limits, self.front.answer, self.front.count)
        self._pages = StatusPages(self.front, self._channels.connections)
        self._status = self._made(limits.of_status, self._pages.answer, self._pages.count)
        tls = TlsChannels(lambda: self._context, self._channels, reactor)
        self._clients = ClientsOfBalancers(tls, settings.proxy_from, log)
        self._ports: list[Any] = []

    def _made(
        self,
        limits: ServerLimits,
        answer: Callable[[LimitedRequest], None],
        count: Callable[[str], None],
    ) -> Channels:
        """Channels with these limits, for one kind of clients."""
        return Channels(
            reactor,
            seconds=limits.seconds,
            classical=self._settings.classical,
            buffered=limits.buffered,
            connections=Connections(limits),
            most=self.front.most,
            answer=answer,
            count=count,
        )

    def run(self) -> None:
        """Answer until SIGTERM."""
        settings = self._settings
        _raise_file_limit(settings.limits.connections)
        globalLogBeginner.beginLoggingTo([_observe], redirectStandardIO=False, discardBuffer=True)
        sockets = given_sockets(os.environ) or [bound(each) for each in settings.listen]
        addresses = [_address(each) for each in sockets]
        for each in sockets:
            self._ports.append(_adopted(each, self._clients))
        if settings.status:
            self._ports.append(_adopted(bound(settings.status), PlainChannels(self._status)))
        for number, handler in ((signal.SIGTERM, self._stop), (signal.SIGHUP, self._reload)):
            signal.signal(number, lambda *_, call=handler: reactor.callFromThread(call))
        signal.signal(signal.SIGINT, signal.getsignal(signal.SIGTERM))
        stay()
        log({"event": "the server listens", "url": settings.url, "addresses": addresses})
        reactor.callWhenRunning(notify, "READY=1", os.environ)
        reactor.run(installSignalHandlers=False)

    def _reload(self) -> None:
        """Read certificates and limits again; open connections stay."""
        try:
            found = read_settings(self._settings.path)
            context = tls_context(found)
        except PqsecError as error:
            self.front.trouble = f"the configuration is not changed: {error}"
            log({"event": "the configuration is not changed", "detail": str(error)})
            return
        self.front.trouble = ""
        self._context, self._settings = context, found
        self.front.use(found.limits)
        self._channels.use(found.limits)
        self._status.use(found.limits.of_status)
        self._pages.use(found.limits.of_status)
        self._channels.classical = found.classical
        self._clients.networks = found.proxy_from
        log({"event": "the configuration was read again"})

    def _stop(self) -> None:
        """Accept nothing more, and end when all answers are written."""
        for each in self._ports:
            each.stopListening()
        self._ports = []
        until = reactor.seconds() + _GRACE
        self._end(until)

    def _end(self, until: float) -> None:
        if not self.front.calls.open or reactor.seconds() > until:
            reactor.callLater(0.1, reactor.stop)
        else:
            reactor.callLater(0.05, self._end, until)


def run_front(settings: ServerSettings) -> None:
    """Answer clients until SIGTERM, or until the signer that started this process ends.

    FileError as of `refuse_open_front`.
    """
    end_with_signer()
    refuse_open_front(settings)
    Listening(settings).run()


def _address(listener: socket) -> str:
    """Where it listens: host and port, or a path."""
    name = listener.getsockname()
    return f"{name[0]}:{name[1]}" if isinstance(name, tuple) else str(name)


def _adopted(given: socket, factory: Any) -> Any:
    """Listen there with Twisted, which duplicates the socket."""
    given.settimeout(0)
    with given:
        return reactor.adoptStreamPort(given.fileno(), given.family, factory)


def _raise_file_limit(connections: int) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = min(hard, max(soft, 2 * connections + 256))
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def _observe(event: Any) -> None:
    """Errors of Twisted itself, which are mistakes of this program, go into the log."""
    failure = event.get("log_failure")
    if failure is not None:
        log({"event": "internal error", "detail": failure.getTraceback()[-2000:]})
