"""The agent's socket: who may connect, and which worker serves it.

The agent reads greetings, answers the command line, and hands all other connections to its workers
(`workers.py`). It never waits for one of them, nor for a file or a host.
"""

import errno
import gc
import os
import selectors
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn

from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin import listening
from pqsec_pki.plugin.agent_folder import AgentFolder
from pqsec_pki.plugin.calls import CONTROL
from pqsec_pki.plugin.command_line import CommandLine
from pqsec_pki.plugin.connection import GREETED, AgentContext
from pqsec_pki.plugin.greeting import Greeting, VersionError
from pqsec_pki.plugin.incoming import IncomingConnection, IncomingConnections, refuse
from pqsec_pki.plugin.inherited import Inherited
from pqsec_pki.plugin.lists import MAX_CAS
from pqsec_pki.plugin.notes import Clock, Log, Notes
from pqsec_pki.plugin.staying import load_the_rest, replaced, staying
from pqsec_pki.plugin.system import keep_limits
from pqsec_pki.plugin.worker import AgentWorker
from pqsec_pki.plugin.workers import Served, Workers

MAX_CONNECTIONS = 512
"""Connections. A DDS process has two for each domain."""
_GRACE_SECONDS = 20.0
"""Seconds that the process that started the agent may take to connect."""
_LONGEST_WAIT = 3600.0
RESERVED_FILES = 32 + MAX_CAS
"""Open files that are reserved for other things than connections, such as revocation lists."""
_SPARE = 8
"""Further connections for the command line: a full agent must still answer and stop."""
_EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_QUIET = 1.0
"""Seconds without calls after which the agent loads modules that its first start left out."""
_REPLACED = "another version was installed"
_PAUSE = 0.5
"""Seconds until the next try to accept a connection, if the system had no file left."""


class Agent:
    """The agent. It listens until it is stopped, or no process was connected for `idle` seconds.

    With `stays`, it then ends only if it should no longer stay. `starter` is the host that started
    it, if one did.
    """

    def __init__(  # noqa: PLR0913 -- the rarer ones by name
        self,
        place: AgentFolder,
        idle: float,
        clock: Clock,
        log: Log,
        *,
        stays: bool = False,
        starter: int | None = None,
    ) -> None:
        self._place, self._idle, self._clock, self._log = place, idle, clock, log
        self._stays, self._starter = stays, starter
        self._is_loaded = False
        self._notes = Notes("agent", log, clock)
        self._most = MAX_CONNECTIONS
        self._paused_until = 0.0
        self._why = ""
        """Why it has retired; empty if it has not."""
        self._stopping = False

    def run(
        self, ready: Callable[[], None] = lambda: None, given: socket.socket | None = None
    ) -> bool:
        """Serve until the end; False if another agent listens there. FileError if it cannot listen.

        `ready` is called when it listens. A `given` socket belongs to systemd, and is not removed.
        """
        self._place.prepare()
        if given:
            self._listen_at(given, ready)
            self._end()
            return True
        with listening.lock(self._place.lock):
            if listening.answers(self._place.socket):
                return False
            listening.remove_unused(each.socket for each in self._place.retired)
            listener = listening.bound(self._place.socket)
            own = listening.made(self._place.socket)
        self._listen_at(listener, ready)
        with listening.lock(self._place.lock), suppress(FileNotFoundError):
            if listening.made(self._place.socket) == own:  # and not a later agent's
                self._place.socket.unlink()
        self._end()
        return True

    def _listen_at(self, listener: socket.socket, ready: Callable[[], None]) -> None:
        self._most = min(MAX_CONNECTIONS, max(1, keep_limits(MAX_CONNECTIONS) - RESERVED_FILES))
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # ignored, the system would reap workers
        self._may_stay = staying(self._place.socket) if self._stays else lambda: False
        self._is_old = replaced() if self._stays else lambda: False
        self._inherited = Inherited(MAX_CONNECTIONS) if self._stays else None
        ready()
        gc.freeze()  # what workers share with the agent stays as it is
        self._listener = listener
        self._selector = selectors.DefaultSelector()  # which would not outlive a fork
        self._workers = Workers(self._work, self._selector, self._notes.add)
        context = AgentContext(self._clock, self._log, self._status, self._stop)
        self._command_line = CommandLine(context, self._selector, self._workers, self._notes.add)
        self._incoming = IncomingConnections(
            self._selector,
            self._starter if self._inherited else None,
            self._greeted,
            self._notes.add,
        )
        self._selector.register(listener, selectors.EVENT_READ, lambda _: self._accept())
        self._log(f"listening at {self._place.socket}")
        with listener:
            self._serve()

    def _end(self) -> None:
        self._workers.end()
        is_shown = bool(self._why) and self._listener.fileno() >= 0
        self._listener.close()
        if is_shown:
            self._place.own_retired.socket.unlink(missing_ok=True)
        for each in self._links:
            each.close()
        self._log("ended")

    def _serve(self) -> None:
        end = time.monotonic() + max(self._idle, _GRACE_SECONDS)
        while not self._stopping and (self._count or (time.monotonic() < end and not self._why)):
            busy = bool(self._count)
            wait = _LONGEST_WAIT if busy else min(end - time.monotonic(), _LONGEST_WAIT)
            found = self._selector.select(min(wait, self._until_next_step()))
            for key, events in found:
                if key.fileobj.fileno() >= 0:  # type: ignore[union-attr] # may be closed since
                    key.data(events)
            self._command_line.answer()
            overdue = self._incoming.starter_until
            if overdue and time.monotonic() >= overdue:
                self._incoming.read_deferred()
            if not (found or self._is_loaded):
                self._is_loaded = True
                load_the_rest(self._notes.add)
            if busy or (time.monotonic() >= end and self._may_stay()):
                end = time.monotonic() + self._idle

    @property
    def _count(self) -> int:
        """The number of connections."""
        return len(self._incoming) + len(self._command_line) + len(self._workers)

    @property
    def _links(self) -> list[socket.socket]:
        """The sockets that the agent reads itself."""
        return self._incoming.links + self._command_line.links

    def _until_next_step(self) -> float:
        """Seconds until the next step that no event starts."""
        now, idle = time.monotonic(), self._workers.dismiss_idle()
        waits = [until - now for until in self._command_line.due]
        if idle is not None:
            waits.append(idle)
        if not self._is_loaded:
            waits.append(_QUIET)
        if self._incoming.starter_until:
            waits.append(self._incoming.starter_until - now)
        if self._paused_until > now:
            waits.append(self._paused_until - now)
        elif self._paused_until:  # the pause is over
            self._paused_until = 0.0
            self._selector.register(self._listener, selectors.EVENT_READ, lambda _: self._accept())
        return max(0.0, min(waits, default=_LONGEST_WAIT))

    def _accept(self) -> None:
        try:
            link, _ = self._listener.accept()
        except OSError as error:  # it may have gone already
            if error.errno in _EXHAUSTED:
                self._notes.add(f"no more processes can be served: {error.strerror}")
                self._selector.unregister(self._listener)
                self._paused_until = time.monotonic() + _PAUSE
            return
        process, user = listening.peer(link)
        link.settimeout(0)
        if user != os.geteuid():
            self._notes.add(f"process {process} of user {user} is not served")
            link.close()
        elif self._count >= self._most + _SPARE:
            self._refuse_full(link, process)
        else:
            self._incoming.add(IncomingConnection(link, process))

    def _greeted(self, incoming: IncomingConnection, greeting: Greeting | VersionError) -> None:
        if isinstance(greeting, VersionError):
            if not self._leaves_to_new_agent(incoming):
                refuse(incoming.link, str(greeting))
        elif greeting.plugin == CONTROL:
            self._command_line.serve(incoming)
        else:
            self._hand_over(incoming, greeting)

    def _refuse_full(self, link: socket.socket, process: int) -> None:
        why = (
            f"{self._most} connections are the maximum, two for each domain of a DDS process:"
            f" {self._most // 2} processes with one domain each"
        )
        self._notes.add(f"process {process} is not served: {why}")
        refuse(link, f"the agent is full: {why}")

    def _hand_over(self, incoming: IncomingConnection, greeting: Greeting) -> None:
        if self._leaves_to_new_agent(incoming, greeting):
            return
        if len(self._workers) >= self._most:
            self._refuse_full(incoming.link, incoming.process)
            return
        try:
            incoming.link.send(GREETED)
            self._workers.serve(
                incoming.link, Served(incoming.process, incoming.who, greeting.plugin)
            )
            incoming.link.close()
        except OSError as error:
            self._notes.add(f"{incoming.who} is not served: {error.strerror}")
            refuse(incoming.link, f"no worker can serve it: {error.strerror}")

    def _leaves_to_new_agent(
        self, incoming: IncomingConnection, greeting: Greeting | None = None
    ) -> bool:
        """Whether a new agent must serve it, because this one cannot, and retires.

        The connection closes without a reason, so the library connects again, and starts the agent
        that is installed now.
        """
        if not self._why and (why := self._mismatch(incoming, greeting)):
            self._retire(why)
        if self._why:
            incoming.link.close()
        return bool(self._why)

    def _mismatch(self, incoming: IncomingConnection, greeting: Greeting | None) -> str:
        """Why this agent cannot serve the host; empty if it can.

        It always serves the host that started it: otherwise that host would start agents for ever.
        """
        if self._is_old():
            return _REPLACED
        if greeting is None or not self._inherited or self._is_starter(incoming):
            return ""
        return self._inherited.mismatch(incoming.link, incoming.process, greeting)

    def _is_starter(self, incoming: IncomingConnection) -> bool:
        """Whether the host that started the agent connects; a later process may have its number."""
        is_there = self._incoming.starter_until or any(
            each.process == self._starter for each in self._workers.served
        )
        return bool(is_there) and incoming.process == self._starter

    def _retire(self, why: str) -> None:
        """Listen only for the command line; present hosts stay until they end.

        The file of the socket stays, as that of an agent that was killed: the next one replaces it.
        """
        self._notes.add(f"{why}: a new agent serves the next hosts")
        if not self._paused_until:
            self._selector.unregister(self._listener)
        self._why, self._paused_until = why, 0.0
        self._listener.close()
        try:
            self._listener = listening.bound(self._place.own_retired.socket)
        except PqsecError as error:
            self._notes.add(f"it is not shown by `pqsec agent status`: {error}")
        else:
            self._selector.register(self._listener, selectors.EVENT_READ, lambda _: self._accept())

    def _work(self, orders: socket.socket, lists: socket.socket) -> NoReturn:
        """Run in a new worker."""
        code = 1
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's is for the agent
            self._selector.close()
            for each in (self._listener, *self._links):
                each.close()
            self._workers.close()
            AgentWorker(orders, lists, self._clock, self._log).run()
            code = 0
        except Exception:  # noqa: BLE001 -- there is nobody else to tell
            import traceback  # noqa: PLC0415 -- likewise

            self._notes.add(traceback.format_exc())
        finally:
            os._exit(code)

    def _status(self) -> dict[str, Any]:
        found = [(each.who, each.plugin, each.objects) for each in self._workers.served]
        return {
            "process": os.getpid(),
            "workers": self._workers.processes,
            "socket": str((self._place.own_retired if self._why else self._place).socket),
            "notice": self._notice(),
            "connections": [
                {"process": who, "plugin": plugin, "objects": count}
                for who, plugin, count in sorted(found)
            ],
        }

    def _notice(self) -> str:
        """A fact about this agent that the user should know, and the action to take."""
        if self._is_old():
            return f"{_REPLACED}: restart these hosts, which use the previous one"
        return f"{self._why}: it serves its present hosts only" if self._why else ""

    def _stop(self) -> None:
        self._stopping = True
