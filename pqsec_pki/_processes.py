"""Distribute work to one process for each core.

The library that creates keys and signatures holds the interpreter lock, so threads would
wait for each other. A fork has the CAs' keys in its memory, so they are sent through no pipe.
It ends with its parent, whatever ends that, and shares no lock with it (`_locks.py`).
OpenSSL and the system give a fork other random octets than its parent.

`concurrent.futures` does not replace this: before Python 3.14 its executor cannot end a busy
process, its forks outlive a killed parent, and an error that cannot be unpickled looks like a
killed process.
"""

import os
import pickle
import signal
import stat
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pqsec_pki._progress import counted, stage
from pqsec_pki.errors import PqsecError

LEAST = 16
"""Number of items for which another process is started."""
_MOMENTS = 20
"""Milliseconds until the system no longer lists a thread that has ended."""
_ON_PARENTS_END = 1
"""PR_SET_PDEATHSIG of prctl(2)."""
_LAST_STREAM = 2
"""The number of standard error."""

Done = TypeVar("Done")
_alone = False
"""Whether this process holds something that a fork of it could not use."""


class _Failure(NamedTuple):
    number: int
    """The number of the item."""
    error: Exception


class _Fork(NamedTuple):
    process: int
    pipe: int
    """The pipe to which it writes its result at its end."""


def shared_out(work: Callable[..., Done], *columns: Sequence[Any]) -> list[Done]:
    """Like map, but in several processes if there are enough items.

    Results and errors of `work` must be picklable. If it fails, the error of the first item
    that fails is raised, after all processes have ended. PqsecError if a process is killed.
    """
    items = list(zip(*columns, strict=True))
    count = len(items) // LEAST
    if count <= 1 or (count := min(count, _cores())) == 1:
        results: list[Done] = []
        with stage(len(items)) as here:  # not `counted`: an error would keep its generator open
            for item in items:
                results.append(work(*item))
                here.add(1)
        return results
    shares = [range(number, len(items), count) for number in range(count)]

    def do(share: Iterable[int]) -> list[Done] | _Failure:
        return _done(work, items, share)

    done: list[Any] = [None] * len(items)
    failures = []
    with stage(len(items)), _forks(do, shares[1:]) as forks:
        for share in shares:
            # The others have as much to do, and report nothing before they end.
            own = counted(share, len(items), each=count)
            found = _answer(forks[share]) if share in forks else do(own)
            if isinstance(found, _Failure):
                failures.append(found)
            else:
                done[share.start :: count] = found
    if failures:
        raise min(failures, key=lambda failure: failure.number).error
    return done


def stay_alone() -> None:
    """From now on `shared_out` works in this process alone, which holds what no fork can use."""
    global _alone  # noqa: PLW0603 -- true of the whole process
    _alone = True


def _done(
    work: Callable[..., Done], items: Sequence[tuple[Any, ...]], share: Iterable[int]
) -> list[Done] | _Failure:
    found = []
    for number in share:
        try:
            found.append(work(*items[number]))
        except Exception as error:  # noqa: BLE001 -- the parent raises it
            return _Failure(number, error)
    return found


@contextmanager
def _forks(
    do: Callable[[Iterable[int]], object], shares: Sequence[range]
) -> Iterator[dict[range, _Fork]]:
    """A process for each share, or fewer if the system allows no more; all end on exit."""
    forks: dict[range, _Fork] = {}
    # Only this process handles Ctrl-C; it then ends the others.
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
        _close_links(but=writer)
        end_with(parent)
        found = _packed(do(takewhile(lambda _: os.getppid() == parent, share)))
        with os.fdopen(writer, "wb") as pipe:
            pipe.write(found)
    finally:
        os._exit(0)  # even after an error, so that no exit handler of the parent runs twice


def end_with(parent: int) -> None:
    """Let the system kill this process when `parent`, its parent, ends; end now if it has ended."""
    import ctypes  # noqa: PLC0415 -- takes a millisecond, and few commands need it

    if prctl := getattr(ctypes.CDLL(None), "prctl", None):  # Linux
        prctl(_ON_PARENTS_END, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)


def _close_links(*, but: int) -> None:
    """Close the pipes and sockets of the parent, except standard streams and the pipe `but`.

    A fork that held the reader of its own pipe, or of another's, would wait for ever to write
    after the parent was killed; and with a socket of the parent, a server would keep its locks.
    """
    signal.set_wakeup_fd(-1)
    for name in os.listdir("/proc/self/fd"):  # noqa: PTH208 -- a number
        handle = int(name)
        with suppress(OSError):  # of the listing itself
            mode = os.fstat(handle).st_mode
            if handle > _LAST_STREAM and handle != but and _is_link(mode):
                os.close(handle)


def _is_link(mode: int) -> bool:
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def _packed(found: object) -> bytes:
    """The result, pickled; if that fails, an error that describes it."""
    try:
        packed = pickle.dumps(found)
        if isinstance(found, _Failure):
            pickle.loads(packed)  # noqa: S301 -- of this process
    except Exception as error:  # noqa: BLE001 -- any class may fail to pickle
        number, what = found if isinstance(found, _Failure) else (0, error)
        packed = pickle.dumps(_Failure(number, RuntimeError(f"{type(what).__name__}: {what}")))
    return packed


def _answer(fork: _Fork) -> Any:
    with os.fdopen(fork.pipe, "rb", closefd=False) as pipe:
        answer = pipe.read()
    try:
        return pickle.loads(answer)  # noqa: S301 -- of a fork of this process
    except (EOFError, pickle.UnpicklingError) as error:
        raise PqsecError(
            "a worker process was killed", hint="if memory ran out, process fewer items at once"
        ) from error


def _cores() -> int:
    """The number of cores that this process may use; 1 if it cannot safely be forked.

    A fork of a process with several threads may hang, because another thread may hold a lock.
    And if SIGCHLD is ignored, which a parent may have set, the process cannot wait for a fork.
    """
    if _alone or signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN or not _has_one_thread():
        return 1
    return len(os.sched_getaffinity(0))


def _has_one_thread() -> bool:
    """Whether this process has one thread; waits a moment for joined threads to disappear."""
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
