"""The lock of a keystore: one thread of one process changes it at a time.

It is an flock on the folder itself: it ends with the process that holds it, whose forks have no
part in it, and leaves no file.
"""

import fcntl
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki._locks import lock, unshared
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._outsiders import refuse_open_keystore

PATIENCE = 30.0
"""Seconds to wait for another command to finish with the keystore."""


class _Held(threading.local):
    """The keystores that this thread of this process has locked; a fork has locked none."""

    def __init__(self) -> None:
        self.roots: dict[tuple[int, Path], Folder] = {}
        self.holds: dict[tuple[int, Path], int] = {}
        self.count = 0


_held = _Held()


@contextmanager
def locked(root: Path) -> Iterator[Folder]:
    """Lock the keystore at `root` for changes; this thread may hold the lock already.

    KeystoreError if another process locks it for half a minute, or another user could change it or
    a folder above it.
    """
    this = (os.getpid(), root)
    if this in _held.roots:
        yield _held.roots[this]
        return
    refuse_open_keystore(root)
    with Folder.opened(root) as folder, unshared(folder.handle):
        folder.refuse_outsiders()
        _lock(folder, fcntl.LOCK_EX)
        _held.count += 1
        _held.roots[this], _held.holds[this] = folder, _held.count
        try:
            yield folder
        finally:
            del _held.roots[this], _held.holds[this]


def hold_over(path: str) -> int:
    """The number of this thread's hold of the lock of the keystore that has `path`; 0 for none."""
    for (process, root), number in _held.holds.items():
        if process == os.getpid() and path.startswith(f"{root}/"):
            return number
    return 0


@contextmanager
def at_rest(root: Path) -> Iterator[Folder]:
    """Lock the keystore at `root` for reading: other processes cannot change it meanwhile.

    KeystoreError if another process locks it for half a minute.
    """
    this = (os.getpid(), root)
    if this in _held.roots:
        yield _held.roots[this]
        return
    with Folder.opened(root) as folder, unshared(folder.handle):
        _lock(folder, fcntl.LOCK_SH)
        yield folder


def _lock(folder: Folder, kind: int) -> None:
    give_up = time.monotonic() + PATIENCE
    while True:
        try:
            lock(folder.handle, kind)
        except BlockingIOError:
            if time.monotonic() > give_up:
                raise KeystoreError(
                    f"{folder.path}: another pqsec command is using this keystore"
                ) from None
            time.sleep(0.05)
        else:
            return
