"""Locks on folders that end with the process that took them.

A fork shares its parent's descriptors, so it would keep a lock of flock(2) when the parent is
killed. Here a fork gets a descriptor of the same folder without the lock.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager

_locked: set[int] = set()
"""The descriptors of folders that this process may have locked."""


@contextmanager
def unshared(folder: int) -> Iterator[None]:
    """Within it, no fork of this process shares a lock on the descriptor `folder`."""
    _locked.add(folder)
    try:
        yield
    finally:
        _locked.discard(folder)


def lock(folder: int, kind: int) -> None:
    """Lock the descriptor `folder`; BlockingIOError if another process has the lock.

    `kind` is `fcntl.LOCK_EX` or `fcntl.LOCK_SH`.
    """
    fcntl.flock(folder, kind | fcntl.LOCK_NB)


def _open_again() -> None:
    """In a fork: open each locked folder again, since the lock is of the open description."""
    for folder in _locked:
        try:
            new = os.open(".", os.O_RDONLY | os.O_DIRECTORY, dir_fd=folder)
        except OSError:
            os.close(folder)
        else:
            os.dup2(new, folder, inheritable=False)
            os.close(new)
    _locked.clear()


os.register_at_fork(after_in_child=_open_again)
