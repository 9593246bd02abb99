"""The copy of a ledger in memory that this thread used last, kept for its next question.

A change asks its ledger eight times, and a server makes one change after another. Without copies it
spent most of its time reading the same lines. A copy is used again only if nothing was changed.
While the keystore is locked, a question inside another one shares its copy.
"""

import os
import sqlite3
import threading
import time
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.keystore import _lock

_TICK, _LONG_TICK = 50_000_000, 3_000_000_000
"""Nanoseconds. File systems store times in steps of up to 10 ms, some of one or two seconds. Two
changes within one step can leave the same time."""
_SECOND = 1_000_000_000


class CopyKey(NamedTuple):
    """The content of which a copy was made."""

    place: str
    version: tuple[int, ...] = ()
    """The version of a file, as of `file_version`; empty for a database."""
    changed: int = 0
    """The time of the file's last change, in nanoseconds; 0 for a database."""

    def shows_changes_after(self, moment: int) -> bool:
        """Whether any change after `moment` gives another key."""
        tick = _TICK if self.changed % _SECOND else _LONG_TICK
        return not self.changed or moment - self.changed > tick


@dataclass(slots=True)
class LedgerCopy:
    """A database in memory with the lines of a ledger."""

    database: sqlite3.Connection
    key: CopyKey | None
    """None if the copy is not used again."""
    process: int
    right_at: int
    """A time at which it had all lines, in nanoseconds: when it was read, or later while the lock
    was held."""
    hold: int = 0
    """The hold of the keystore's lock in which it was used last; 0 for none."""
    users: int = 1
    """How many ledgers are open with it."""
    fits: bytes = b""
    """The signed head whose lines it has: lines are only added, so it still has them."""

    @classmethod
    def new(cls, key: CopyKey | None) -> "LedgerCopy":
        """An empty one."""
        database = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
        return cls(database, key, os.getpid(), time.time_ns())

    def copied(self) -> "LedgerCopy":
        """Another one with the same lines."""
        copy = LedgerCopy.new(self.key)
        limit = self.database.getlimit(sqlite3.SQLITE_LIMIT_LENGTH)
        copy.database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limit)
        copy.database.deserialize(self.database.serialize())
        copy.database.execute("PRAGMA trusted_schema = OFF")
        return copy

    def __del__(self) -> None:
        """Close the database when its thread has ended, maybe from another thread."""
        self.database.close()

    def has_all(self, key: CopyKey) -> bool:
        """Whether it has what is at that place now, `key`."""
        if self.key != key or self.process != os.getpid():
            return False
        return self.is_locked(key.place) or key.shows_changes_after(self.right_at)

    def is_locked(self, place: str) -> bool:
        """Whether the lock at `place` was not released since it was used last."""
        return self.hold != 0 and self.hold == _lock.hold_over(place)


class _Copies(threading.local):
    kept: LedgerCopy | None = None
    shared: LedgerCopy | None = None
    """One in use, opened while the keystore was locked: no other process adds lines."""


_copies = _Copies()


def take(key: CopyKey | None) -> LedgerCopy | None:
    """The copy with that key, to read; None if there is none."""
    kept, shared = _copies.kept, _copies.shared
    if key and shared and shared.is_locked(key.place) and shared.has_all(key):
        shared.users += 1
        return shared
    if key is None or kept is None or not kept.has_all(key):
        return None
    _copies.kept = None
    return kept


def share(copy: LedgerCopy) -> None:
    """Let others read the copy until it is changed, while the keystore is locked."""
    if copy.key and (hold := _lock.hold_over(copy.key.place)):
        copy.hold = hold
        _copies.shared = copy


def to_change(copy: LedgerCopy) -> LedgerCopy:
    """The copy for this caller alone; another one if others read it."""
    if copy is _copies.shared:
        _copies.shared = None
    if copy.users == 1:
        return copy
    copy.users -= 1
    return copy.copied()


def give_back(copy: LedgerCopy) -> None:
    """Keep the copy, in place of the last one, or close it; others may read it still."""
    copy.users -= 1
    if copy.users:
        return
    copy.users = 1
    if copy is _copies.shared:
        _copies.shared = None
    if copy.key is None:
        copy.database.close()
        return
    if hold := _lock.hold_over(copy.key.place):
        copy.hold, copy.right_at = hold, time.time_ns()
    if _copies.kept:
        _copies.kept.database.close()
    _copies.kept = copy
