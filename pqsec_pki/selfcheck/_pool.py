"""Worker processes that share the work of one all-pairs job.

Fresh processes, because a fork of a process that has threads may hang. If one is killed, the
job ends with an error; all end with the process that started them.
"""

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process, resource_tracker
from typing import TypeVar

from pqsec_pki.errors import PqsecError
from pqsec_pki.selfcheck._worker import AllPairsJob, Worker

AHEAD = 2
"""Blocks queued for each process."""

Block = TypeVar("Block")
Done = TypeVar("Done")


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Several worker processes, or only the current process."""

    worker: Worker
    executor: ProcessPoolExecutor | None = None
    size: int = 1

    def map(self, work: Callable[[Worker, Block], Done], blocks: Iterable[Block]) -> Iterator[Done]:
        """The results of `work`, a method of the worker, for each block, in order.

        Few blocks are read ahead. PqsecError if a process is killed.
        """
        if self.executor is None:
            yield from (work(self.worker, block) for block in blocks)
            return
        waiting: deque[Future[Done]] = deque()
        try:
            for block in blocks:
                with _interrupts_blocked():  # the executor may start a process
                    waiting.append(self.executor.submit(_work, work, block))
                if len(waiting) > AHEAD * self.size:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except BrokenProcessPool as error:
            raise PqsecError(
                "a worker process was killed",
                hint="if memory ran out, use fewer processes: --jobs 1",
            ) from error


@contextmanager
def worker_pool(job: AllPairsJob, size: int) -> Iterator[WorkerPool]:
    """A pool of `size` processes, ended on exit; with `size` 1, the current process."""
    worker = Worker.of(job)
    if size == 1:
        yield WorkerPool(worker)
        return
    executor = ProcessPoolExecutor(size, get_context("spawn"), _start, (job,))
    try:
        yield WorkerPool(worker, executor, size)
    finally:
        executor.shutdown(cancel_futures=True)


_workers: list[Worker] = []
"""In a worker process, its worker."""


def _start(job: AllPairsJob) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _workers.append(Worker.of(job))


def _work(work: Callable[[Worker, Block], Done], block: Block) -> Done:
    return work(_workers[0], block)


def _end_with_parent() -> None:
    """End this process when its parent has ended: the executor's own pipes do not show that."""
    if parent := parent_process():
        parent.join()
        os._exit(0)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT for processes that start within: on Ctrl-C the parent ends them."""
    resource_tracker.ensure_running()  # its start would unblock SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
