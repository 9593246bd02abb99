"""Who changes a keystore holds it: one thread of one process at a time.

The lock is the system's, on the folder itself: it ends with the process that has it.
"""

import fcntl
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki.errors import KeystoreError

PATIENCE = 30.0
"""Seconds to wait for another command to finish with the keystore."""


class _Held(threading.local):
    """What this thread of this process has locked already; a fork has not."""

    def __init__(self) -> None:
        self.roots: set[tuple[int, Path]] = set()


_held = _Held()


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """Holds the keystore at `root`, which this thread may have done already.

    KeystoreError if another holds it for half a minute.
    """
    this = (os.getpid(), root)
    if this in _held.roots:
        yield
        return
    handle = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _lock(handle, root)
        _held.roots.add(this)
        yield
    finally:
        _held.roots.discard(this)
        os.close(handle)


def _lock(handle: int, root: Path) -> None:
    give_up = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > give_up:
                raise KeystoreError(f"{root}: another pqsec command is at work here") from None
            time.sleep(0.05)
        else:
            return
