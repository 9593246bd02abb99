"""Work shared out to a process for each core.

The library that makes keys and signatures holds the interpreter while it does, so threads
would wait for each other. A fork has the CAs' keys in its memory: they travel through no
pipe. OpenSSL and the system give a fork other random octets than its parent.
"""

import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pqsec_pki.errors import PqsecError

LEAST = 16
"""Items that are worth a process."""
_MOMENTS = 20
"""Milliseconds that a thread may take to be gone once it has ended."""

Done = TypeVar("Done")


class _Failure(NamedTuple):
    number: int
    """Of the item."""
    error: Exception


class _Fork(NamedTuple):
    process: int
    pipe: int
    """What it did comes here, at its end."""


def shared_out(work: Callable[..., Done], *columns: Sequence[Any]) -> list[Done]:
    """As map, but by several processes where that is worth it.

    What `work` gives and raises must be picklable. If it fails, the error of the first
    item that fails is raised, once all processes have ended. PqsecError if one is killed.
    """
    items = list(zip(*columns, strict=True))
    count = min(_cores(), len(items) // LEAST)
    if count <= 1:
        return [work(*item) for item in items]
    shares = [range(number, len(items), count) for number in range(count)]

    def do(share: Iterable[int]) -> list[Done] | _Failure:
        return _done(work, items, share)

    done: list[Any] = [None] * len(items)
    failures = []
    with _forks(do, shares[1:]) as forks:
        for share in shares:
            found = _answer(forks[share]) if share in forks else do(share)
            if isinstance(found, _Failure):
                failures.append(found)
            else:
                done[share.start :: count] = found
    if failures:
        raise min(failures, key=lambda failure: failure.number).error
    return done


def _done(
    work: Callable[..., Done], items: Sequence[tuple[Any, ...]], share: Iterable[int]
) -> list[Done] | _Failure:
    found = []
    for number in share:
        try:
            found.append(work(*items[number]))
        except Exception as error:  # noqa: BLE001 -- raised by who reads it
            return _Failure(number, error)
    return found


@contextmanager
def _forks(
    do: Callable[[Iterable[int]], object], shares: Sequence[range]
) -> Iterator[dict[range, _Fork]]:
    """A process for each share, as far as the system lets there be more; at the end, none."""
    forks: dict[range, _Fork] = {}
    # Ctrl-C is for this process, which then ends the others.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with suppress(OSError):
            for share in shares:
                forks[share] = _fork(do, share)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield forks
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for fork in forks.values():
            os.close(fork.pipe)
            os.kill(fork.process, signal.SIGKILL)
            os.waitpid(fork.process, 0)


def _fork(do: Callable[[Iterable[int]], object], share: Iterable[int]) -> _Fork:
    reader, writer = os.pipe()
    parent = os.getpid()
    process = os.fork()
    if process:
        os.close(writer)
        return _Fork(process, reader)
    try:
        found = _packed(do(takewhile(lambda _: os.getppid() == parent, share)))
        with os.fdopen(writer, "wb") as pipe:
            pipe.write(found)
    finally:
        os._exit(0)  # whatever was raised: nothing of the parent's is ended twice


def _packed(found: object) -> bytes:
    """For the way home; of what cannot be read there, an error that says what it is."""
    try:
        packed = pickle.dumps(found)
        if isinstance(found, _Failure):
            pickle.loads(packed)  # noqa: S301 -- of this process
    except Exception as error:  # noqa: BLE001 -- its class may be anybody's
        number, what = found if isinstance(found, _Failure) else (0, error)
        packed = pickle.dumps(_Failure(number, RuntimeError(f"{type(what).__name__}: {what}")))
    return packed


def _answer(fork: _Fork) -> Any:
    with os.fdopen(fork.pipe, "rb", closefd=False) as pipe:
        said = pipe.read()
    try:
        return pickle.loads(said)  # noqa: S301 -- of a fork of this process
    except (EOFError, pickle.UnpicklingError) as error:
        raise PqsecError(
            "one of the processes at work was killed", hint="if memory is short, do fewer at once"
        ) from error


def _cores() -> int:
    """How many this process may use; one where it cannot safely be forked.

    A fork of a process with several threads may hang: another may hold a lock. And where
    the signal of a child's end is ignored, as its parent may have left it, nobody can wait
    for one.
    """
    if signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN or not _has_one_thread():
        return 1
    return len(os.sched_getaffinity(0))


def _has_one_thread() -> bool:
    """Also where one that was joined needs another moment to be gone."""
    for _ in range(_MOMENTS):
        try:
            threads = list(Path("/proc/self/task").iterdir())
        except OSError:
            return False
        if len(threads) == 1:
            return True
        if threading.active_count() > 1:
            return False
        time.sleep(0.001)
    return False
