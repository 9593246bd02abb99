"""The ledger's file: read as a whole, and replaced as a whole.

SQLite works in memory only and opens no file in the keystore: others cannot plant files that
it would read beside the database, or links that it would follow. A reader needs neither a
lock nor a writable folder, and gets a consistent state: the file is replaced, never modified.
"""

import os
import sqlite3
import stat
import tempfile
from collections.abc import Iterable
from contextlib import closing, suppress
from pathlib import Path

from pqsec_pki._files import PRIVATE_MODE, create
from pqsec_pki.errors import FileError, KeystoreError, TooLargeError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry, details_text
from pqsec_pki.keystore._folder import Folder, should_be

MAX_SIZE = 512 << 20
"""Bytes; about 400,000 participants, each renewed once. SQLite takes 1 GiB into memory."""

_RESERVED = 1024
"""This part of the size, the last, is for revocations: a full ledger must not prevent them."""
_REVOKING = frozenset({"revocation", "compromise", "crl"})
_OF_LINE = 4096, 4
"""Bytes that a line takes at most: so many, and so many times its text, in table and indices."""

_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
_WAL, _ROLLBACK = "-wal", "-journal"
_BESIDE = (_WAL, "-shm", _ROLLBACK)
"""SQLite's files beside a database. The first may have the newest lines of an earlier pqsec."""
_VERSIONS = slice(18, 20)
_USES_WAL, _USES_NONE = b"\x02\x02", b"\x01\x01"
"""The file format versions of https://www.sqlite.org/fileformat.html, 1.3.1."""


def limit_for(entries: Iterable[Entry]) -> int:
    """The size that the file may have with these new lines, in bytes."""
    revokes = all(each.kind in _REVOKING for each in entries)
    return MAX_SIZE if revokes else MAX_SIZE - MAX_SIZE // _RESERVED


def most_with(private: Folder, entries: Iterable[Entry]) -> int:
    """A size, in bytes, over which the file will not be with these new lines."""
    size, (fixed, times) = 0, _OF_LINE
    for name in (layout.LEDGER, layout.LEDGER + _WAL):
        with suppress(FileNotFoundError):
            size += os.lstat(name, dir_fd=private.handle).st_size
    return size + sum(fixed + times * len(f"{each.name}{details_text(each)}") for each in entries)


def refuse_larger(size: int, limit: int | None = None) -> None:
    """TooLargeError for a file of that size [default of the limit: what `load` reads]."""
    hint = "keep it in a database: `pqsec ledger move ADDRESS`; docs/how-to/postgresql.md"
    TooLargeError.check("the ledger", size, MAX_SIZE if limit is None else limit, hint=hint)


def load(private: Folder) -> bytes | None:
    """The database; None if there is none. KeystoreError for a link, or if it is not a database.

    It includes lines that an earlier version left in the write-ahead log.
    """
    data = _read(private, layout.LEDGER)
    if data is None:
        return None
    if _read(private, layout.LEDGER + _ROLLBACK):
        # SQLite would use it as a rollback journal, and delete files that it names.
        raise KeystoreError(
            f"{private.path}/{layout.LEDGER}: another program was stopped while changing it",
            hint=f"restore it from a backup, and remove {layout.LEDGER}{_ROLLBACK}",
        )
    if wal := _read(private, layout.LEDGER + _WAL):
        try:
            data = _merged(data, wal)
        except sqlite3.Error as error:
            path = f"{private.path}/{layout.LEDGER}"
            raise KeystoreError(f"{path}: not a ledger: {error}") from error
    if data[_VERSIONS] == _USES_WAL:
        data = data[: _VERSIONS.start] + _USES_NONE + data[_VERSIONS.stop :]
    return data


def version(private: Folder) -> tuple[int, ...]:
    """The version of the database, as of `file_version`; empty if `load` would find more."""
    if any(private.kind(layout.LEDGER + each) is not None for each in _BESIDE):
        return ()
    with suppress(FileNotFoundError):
        found = os.lstat(layout.LEDGER, dir_fd=private.handle)
        if stat.S_ISREG(found.st_mode):
            return (
                *(found.st_dev, found.st_ino, found.st_size),
                *(found.st_mtime_ns, found.st_ctime_ns),
            )
    return ()


def check(private: Folder) -> None:
    """KeystoreError or PermissionError if the ledger could not be replaced."""
    private.refuse_outsiders()
    private.refuse_outsiders_of(layout.LEDGER)
    if not os.access(".", os.W_OK, dir_fd=private.handle):
        raise PermissionError(13, "Permission denied", f"{private.path}/{layout.LEDGER}")


def save(private: Folder, data: bytes, beside: Folder) -> None:
    """Replace the database by `data`, with one rename of a synced file in the folder `beside`.

    TooLargeError if it could not be read again.
    """
    refuse_larger(len(data))
    with suppress(FileNotFoundError):
        os.unlink(layout.LEDGER, dir_fd=beside.handle)  # left by an interrupted attempt
    create(layout.LEDGER, data, mode=_mode(private), sync=True, folder=beside.handle)
    _replace(beside, private)


def settle(private: Folder, beside: Folder) -> None:
    """Merge the write-ahead log that an earlier version left beside the database.

    If it is interrupted, it may be repeated: the same pages are merged again.
    """
    there = [each for each in _BESIDE if private.kind(layout.LEDGER + each) is not None]
    if not there:
        return
    data = load(private)
    if data is not None:
        save(private, data, beside)
        os.fsync(private.handle)
    for each in there:
        os.unlink(layout.LEDGER + each, dir_fd=private.handle)


def _replace(beside: Folder, private: Folder) -> None:
    name = layout.LEDGER
    os.replace(name, name, src_dir_fd=beside.handle, dst_dir_fd=private.handle)


def _mode(private: Folder) -> int:
    """The mode for the new file: it keeps read permissions that the user gave to others."""
    try:
        found = os.lstat(layout.LEDGER, dir_fd=private.handle)
    except FileNotFoundError:
        return PRIVATE_MODE
    return PRIVATE_MODE | found.st_mode & 0o044


def _read(private: Folder, name: str) -> bytes | None:
    path = f"{private.path}/{name}"
    try:
        handle = os.open(name, _READ, dir_fd=private.handle)
    except FileNotFoundError:
        return None
    except OSError as error:
        if private.kind(name) == stat.S_IFLNK:
            raise should_be(path, "file") from None
        error.filename = path
        raise
    with os.fdopen(handle, "rb") as file:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            raise should_be(path, "file")
        if found.st_size > MAX_SIZE:
            raise FileError(f"{path}: larger than {MAX_SIZE} bytes, so not what is expected here")
        return file.read(MAX_SIZE)


def _merged(data: bytes, wal: bytes) -> bytes:
    """The database with the pages of its write-ahead log; SQLite works in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="pqsec-") as folder:
        path = Path(folder, layout.LEDGER)
        path.write_bytes(data)
        path.with_name(layout.LEDGER + _WAL).write_bytes(wal)
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        return path.read_bytes()
