"""Worker processes that share the work of one all-pairs job.

Each has its own pipe and gets every n-th block of work, so results come in order without
locks. No process can hang because another was killed, and all end with the parent.

`concurrent.futures` does not replace this: before Python 3.14 its executor waits for the blocks
in work when the user interrupts, up to a minute with many processes.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import cycle
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._processes import end_with
from pqsec_pki.errors import PqsecError
from pqsec_pki.selfcheck._worker import AllPairsJob, Worker

AHEAD = 2
"""Blocks queued for each process."""
_SAFE_PATH = "PYTHONSAFEPATH"

Block = TypeVar("Block")
Done = TypeVar("Done")


class _Member(NamedTuple):
    process: BaseProcess
    pipe: "Connection[Any, Any]"

    def answer(self) -> Any:
        """The result of its oldest block. PqsecError of its work, or if it was killed."""
        # This process holds both ends of the pipe, so sending to a dead process does not
        # raise SIGPIPE; its sentinel shows that it has ended.
        if self.pipe not in wait([self.pipe, self.process.sentinel]):
            raise PqsecError(
                "a worker process was killed",
                hint="if memory ran out, use fewer processes: --jobs 1",
            )
        found = self.pipe.recv()
        if isinstance(found, PqsecError):
            raise found
        return found


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Several worker processes, or only the current process."""

    worker: Worker
    members: tuple[_Member, ...] = ()

    def map(self, work: Callable[[Worker, Block], Done], blocks: Iterable[Block]) -> Iterator[Done]:
        """The results of `work`, a method of the worker, for each block, in order.

        Few blocks are read ahead. Read all results before the next call.
        PqsecError if a process is killed.
        """
        if not self.members:
            yield from (work(self.worker, block) for block in blocks)
            return
        waiting: deque[_Member] = deque()
        for member, block in zip(cycle(self.members), blocks, strict=False):
            member.pipe.send((work, block))
            waiting.append(member)
            if len(waiting) > AHEAD * len(self.members):
                yield waiting.popleft().answer()
        while waiting:
            yield waiting.popleft().answer()


@contextmanager
def worker_pool(job: AllPairsJob, size: int) -> Iterator[WorkerPool]:
    """A pool of `size` processes, ended on exit; with `size` 1, the current process."""
    worker = Worker.of(job)
    if size == 1:
        yield WorkerPool(worker)
        return
    pipes = [get_context("spawn").Pipe() for _ in range(size)]
    # Fresh processes: a fork of one that has threads may hang.
    members = tuple(
        _Member(get_context("spawn").Process(target=_serve, args=(theirs, job, os.getpid())), ours)
        for ours, theirs in pipes
    )
    try:
        with _safe_path(), _interrupts_blocked():
            for member in members:
                member.process.start()
        yield WorkerPool(worker, members)
    finally:
        with _interrupts_blocked():
            for member in members:
                _end(member.process)


def _serve(pipe: "Connection[Any, Any]", job: AllPairsJob, parent: int) -> None:
    """Run a worker process: answer until the pipe is closed, or the work fails."""
    end_with(parent)
    with suppress(EOFError, OSError):
        try:
            worker = Worker.of(job)
            while True:
                work, block = pipe.recv()
                pipe.send(work(worker, block))
        except PqsecError as error:
            pipe.send(error)


def _end(process: BaseProcess) -> None:
    """Terminate the process: it only reads files, so this is safe at any time."""
    if process.pid is not None:
        process.terminate()
        process.join()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Python processes that start in the block import no modules from their current folder."""
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        del os.environ[_SAFE_PATH]
        if before is not None:
            os.environ[_SAFE_PATH] = before


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT, also for processes that start within: on Ctrl-C the parent ends them."""
    resource_tracker.ensure_running()  # its start would unblock SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
