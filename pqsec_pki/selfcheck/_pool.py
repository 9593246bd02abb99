"""Processes that share the work of one gathering.

Each has its own line to us and gets every n-th block of work, so results come in order
without locks: none can hang where another is killed, and all end when we do.
"""

import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple, TypeVar

from pqsec_pki.errors import PqsecError
from pqsec_pki.selfcheck._worker import AllPairsJob, Worker

AHEAD = 2
"""Blocks that wait for each process."""

Block = TypeVar("Block")
Done = TypeVar("Done")


class _Member(NamedTuple):
    process: BaseProcess
    line: "Connection[Any, Any]"

    def answer(self) -> Any:
        # We hold both ends of the line: a dead process is seen by what it leaves, its
        # sentinel, and what is sent to it does not end us with SIGPIPE.
        if self.line not in wait([self.line, self.process.sentinel]):
            raise PqsecError(
                "one of the processes was killed",
                hint="if memory was short, use fewer of them: --jobs 1",
            )
        return self.line.recv()


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Some processes, or this one alone."""

    worker: Worker
    members: tuple[_Member, ...] = ()

    def map(self, work: Callable[[Worker, Block], Done], blocks: Iterable[Block]) -> Iterator[Done]:
        """What `work`, a method of the worker, makes of each block, in their order.

        Few blocks are read ahead. To be read to its end before it is called again.
        PqsecError if a process is killed.
        """
        if not self.members:
            yield from (work(self.worker, block) for block in blocks)
            return
        waiting: deque[_Member] = deque()
        for member, block in zip(cycle(self.members), blocks, strict=False):
            member.line.send((work, block))
            waiting.append(member)
            if len(waiting) > AHEAD * len(self.members):
                yield waiting.popleft().answer()
        while waiting:
            yield waiting.popleft().answer()


@contextmanager
def worker_pool(job: AllPairsJob, size: int) -> Iterator[WorkerPool]:
    """`size` processes for as long as this lasts; of one, this one."""
    worker = Worker.of(job)
    if size == 1:
        yield WorkerPool(worker)
        return
    lines = [get_context("spawn").Pipe() for _ in range(size)]
    # Fresh processes: a fork of one that has threads may hang.
    members = tuple(
        _Member(get_context("spawn").Process(target=_serve, args=(theirs, job)), ours)
        for ours, theirs in lines
    )
    try:
        with _deaf_to_interrupts():
            for member in members:
                member.process.start()
        yield WorkerPool(worker, members)
    finally:
        for member in members:
            _end(member.process)


def _serve(line: "Connection[Any, Any]", job: AllPairsJob) -> None:
    """What a process does: it answers until nobody asks any more."""
    worker = Worker.of(job)
    try:
        while True:
            work, block = line.recv()
            line.send(work(worker, block))
    except (EOFError, OSError):
        return


def _end(process: BaseProcess) -> None:
    """It only reads, so it can be ended anywhere."""
    if process.pid is not None:
        process.terminate()
        process.join()


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """A process that starts in here never hears of Ctrl-C: the first one does, and ends it."""
    resource_tracker.ensure_running()  # which, as it starts, would let them hear again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
