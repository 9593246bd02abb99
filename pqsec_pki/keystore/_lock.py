"""Who changes a keystore holds it: one thread of one process at a time.

The lock is the system's, on the folder itself: it ends with the process that has it, and
leaves nothing behind.
"""

import fcntl
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore._folder import Folder

PATIENCE = 30.0
"""Seconds to wait for another command to finish with the keystore."""


class _Held(threading.local):
    """What this thread of this process has locked already; a fork has not."""

    def __init__(self) -> None:
        self.roots: dict[tuple[int, Path], Folder] = {}


_held = _Held()


@contextmanager
def locked(root: Path) -> Iterator[Folder]:
    """The keystore at `root`, held; which this thread may have done already.

    KeystoreError if another holds it for half a minute, or it is another's, or another may
    write there.
    """
    this = (os.getpid(), root)
    if this in _held.roots:
        yield _held.roots[this]
        return
    with Folder.opened(root) as folder:
        folder.refuse_outsiders()
        _lock(folder, fcntl.LOCK_EX)
        _held.roots[this] = folder
        try:
            yield folder
        finally:
            del _held.roots[this]


@contextmanager
def at_rest(root: Path) -> Iterator[Folder]:
    """The keystore at `root`, to be read, while nobody changes it.

    KeystoreError if another holds it for half a minute.
    """
    this = (os.getpid(), root)
    if this in _held.roots:
        yield _held.roots[this]
        return
    with Folder.opened(root) as folder:
        _lock(folder, fcntl.LOCK_SH)
        yield folder


def _lock(folder: Folder, kind: int) -> None:
    give_up = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(folder.handle, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > give_up:
                raise KeystoreError(
                    f"{folder.path}: another pqsec command is at work here"
                ) from None
            time.sleep(0.05)
        else:
            return
