"""The agent's workers, as the agent sees them.

They are forked when hosts connect, and end when all of their hosts have gone, which returns their
memory to the system. All connections of a host process are served by one worker. The agent itself
holds no key.
"""

import errno
import os
import selectors
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import field

from pqsec_pki._dataclass import dataclass
from pqsec_pki.plugin import channel
from pqsec_pki.plugin.octets import MessageReader
from pqsec_pki.plugin.shared_lists import ListStore

MAX_WORKERS = 4
"""Other cores are left to other processes: the start of a robot takes seconds of these."""
IDLE_SECONDS = 10.0
"""How long a worker without connections stays: hosts may be started one after another."""
MAX_SILENT = 4
"""Workers that hang, above which none is started in their place."""
SILENT_SECONDS = 5.0
"""A worker that has not answered for so long hangs, as on files of a server that is gone. Others
get the hosts that connect. It is not killed: its own hosts go on when it does."""
_END_SECONDS = 2.0
"""Seconds that a worker may take to end; then it is killed."""


@dataclass(slots=True)
class Served:
    """A connection that a worker serves."""

    process: int
    """The host's."""
    who: str
    plugin: str
    objects: int = 0
    """The worker's last answer."""


@dataclass(slots=True, eq=False)
class WorkerProcess:
    process: int
    orders: socket.socket
    lists: socket.socket
    served: dict[int, Served] = field(default_factory=dict)
    idle_since: float = 0.0
    asked_at: float | None = None
    """Since when its answer about the objects of its connections is awaited; None if it is not."""
    is_dismissed: bool = False

    @property
    def is_silent(self) -> bool:
        return self.asked_at is not None and time.monotonic() - self.asked_at >= SILENT_SECONDS

    def ask(self) -> None:
        """Ask for the objects of its connections, which also shows whether it works."""
        if self.asked_at is None:
            with suppress(OSError):
                channel.put(self.orders, channel.message(channel.STATUS))
                self.asked_at = time.monotonic()


class Workers:
    """At most one for each core."""

    def __init__(
        self,
        run: Callable[[socket.socket, socket.socket], None],
        selector: selectors.BaseSelector,
        note: Callable[[str], None],
    ) -> None:
        """`run` is called in a new worker with its ends of both channels, and does not return.
        `selector` gets a function as the data of each channel."""
        self._run, self._selector, self._note = run, selector, note
        self._most = min(MAX_WORKERS, len(os.sched_getaffinity(0)))
        self._workers: list[WorkerProcess] = []
        self._lists = ListStore()
        self._number = 0

    def __len__(self) -> int:
        """How many connections they serve."""
        return sum(len(each.served) for each in self._workers)

    @property
    def processes(self) -> list[int]:
        return [each.process for each in self._workers]

    @property
    def served(self) -> list[Served]:
        """The connections that they serve."""
        return [each for worker in self._workers for each in worker.served.values()]

    def serve(self, link: socket.socket, served: Served) -> None:
        """Hand a greeted connection over. OSError if that cannot be done."""
        worker = self._for(served.process)
        self._number += 1
        order = channel.message(channel.SERVE)
        order.number("I", self._number)
        order.text(served.plugin)
        order.text(served.who)
        channel.put(worker.orders, order, link.fileno())
        worker.served[self._number] = served
        worker.ask()

    def ask(self) -> None:
        """Ask each worker for the objects of its connections; see `has_answered`."""
        for worker in self._workers:
            worker.ask()

    @property
    def has_answered(self) -> bool:
        """Whether no answer is awaited."""
        return all(each.asked_at is None for each in self._workers)

    def dismiss_idle(self) -> float | None:
        """End workers without connections; the seconds until the next one ends, None if none."""
        now, waits = time.monotonic(), []
        for worker in self._workers:
            if worker.served or worker.is_dismissed:
                continue
            left = worker.idle_since + IDLE_SECONDS - now
            if left > 0:
                waits.append(left)
            else:
                worker.is_dismissed = True
                worker.orders.shutdown(socket.SHUT_WR)
        return min(waits, default=None)

    def end(self) -> None:
        """End all of them, and wait until they have ended."""
        for worker in self._workers:
            self._close(worker)
        until = time.monotonic() + _END_SECONDS
        for worker in self._workers:
            while not os.waitpid(worker.process, os.WNOHANG)[0]:
                if time.monotonic() > until:
                    os.kill(worker.process, signal.SIGKILL)
                time.sleep(0.001)
        self._workers.clear()
        self._lists.close()

    def close(self) -> None:
        """Close the agent's ends of all channels, in a worker that was just forked."""
        for worker in self._workers:
            worker.orders.close()
            worker.lists.close()
        self._lists.close()

    def _for(self, process: int) -> WorkerProcess:
        """The worker of the host's other connections, else the one with the fewest."""
        silent = [each for each in self._workers if each.is_silent]
        able = [each for each in self._workers if not (each.is_dismissed or each in silent)]
        for worker in able:
            # Processes in other PID namespaces all have number 0.
            if process and any(each.process == process for each in worker.served.values()):
                return worker
        least = min(able, key=lambda each: len(each.served), default=None)
        if least is not None and (not least.served or len(able) >= self._most):
            return least
        if len(silent) > MAX_SILENT:
            raise TimeoutError(errno.ETIMEDOUT, f"{len(silent)} workers hang")
        try:
            return self._new()
        except OSError as error:
            if least is None:
                raise
            self._note(f"no further worker can be started: {error.strerror}")
            return least

    def _new(self) -> WorkerProcess:
        ours, theirs = channel.pair()
        ours.settimeout(0)  # the agent waits for no worker
        try:
            lists, others = channel.pair()
        except OSError:
            ours.close()
            theirs.close()
            raise
        process = os.fork()
        if process == 0:
            ours.close()
            lists.close()
            self._run(theirs, others)
        theirs.close()
        others.close()
        lists.settimeout(0)
        worker = WorkerProcess(process, ours, lists)
        self._workers.append(worker)
        self._selector.register(ours, selectors.EVENT_READ, lambda _: self._read(worker))
        self._selector.register(lists, selectors.EVENT_READ, lambda _: self._shown(worker))
        return worker

    def _read(self, worker: WorkerProcess) -> None:
        found = channel.take(worker.orders)
        if found is None:
            self._lost(worker)
            return
        reader, _ = found
        if reader.text() == channel.GONE:
            worker.served.pop(reader.number("I"), None)
            worker.idle_since = time.monotonic()
        else:
            worker.asked_at = None
            for _ in range(reader.number("I")):
                number, objects = reader.number("I"), reader.number("I")
                if number in worker.served:
                    worker.served[number].objects = objects

    def _shown(self, worker: WorkerProcess) -> None:
        found: tuple[MessageReader, int | None] | None = channel.take(worker.lists)
        if found is None:
            self._selector.unregister(worker.lists)
        else:
            self._lists.answer(worker.lists, *found)

    def _lost(self, worker: WorkerProcess) -> None:
        """It has ended."""
        self._close(worker)
        self._workers.remove(worker)
        _, status = os.waitpid(worker.process, 0)
        if worker.served or status:
            code = os.waitstatus_to_exitcode(status)
            self._note(
                f"worker {worker.process} ended with {code}: {len(worker.served)} connections lost"
            )

    def _close(self, worker: WorkerProcess) -> None:
        for each in (worker.orders, worker.lists):
            with suppress(KeyError):
                self._selector.unregister(each)
            each.close()
