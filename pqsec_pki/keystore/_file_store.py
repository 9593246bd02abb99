"""The ledger in a file of the keystore: the store of a keystore that one machine uses."""

import sqlite3
from collections.abc import Iterable, Sequence

from pqsec_pki.errors import KeystoreError, other_format
from pqsec_pki.keystore import _ledger_file, _table, layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._copies import CopyKey
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._ledger import Ledger


class FileStore:
    """The database file in the folder `private`."""

    def __init__(self, private: Folder, *, begin: bool = False) -> None:
        """With `begin` the file may be missing; otherwise a missing file is an error."""
        self._private, self._begin = private, begin
        self.place = f"{private.path}/{layout.LEDGER}"

    @property
    def key(self) -> CopyKey | None:
        """The version of the file; None if an earlier pqsec left another one beside it."""
        found = _ledger_file.version(self._private)
        return CopyKey(self.place, found, max(found[-2:])) if found else None

    def update(self, database: sqlite3.Connection) -> bool:
        """A copy with the same key has all lines."""
        del database
        return True

    def load(self, database: sqlite3.Connection) -> None:
        """The file, with its table created, or converted from format 1, in memory only."""
        data = _ledger_file.load(self._private)
        if data is None and not self._begin:
            raise self._lost()
        if data:
            database.deserialize(data)
        # The file may contain views and triggers that others put there.
        database.execute("PRAGMA trusted_schema = OFF")
        if _table.format_of(database) != _table.FORMAT:
            self._convert(database)
        elif not _table.is_our_own(database):
            raise KeystoreError(
                f"{self.place}: not a ledger: another program made or changed its table",
                hint="restore it from a backup",
            )

    def _convert(self, database: sqlite3.Connection) -> None:
        with _table.transaction(database):
            found = _table.format_of(database)
            if found > _table.FORMAT:
                raise other_format(KeystoreError, found, (1, _table.FORMAT), where=self.place)
            if found < _table.FORMAT:
                if not (self._begin or _table.has_format_1(database)):
                    raise self._lost()
                _table.make(database)

    def _lost(self) -> KeystoreError:
        """The error for a lost ledger: a new one would lack the revocations."""
        return KeystoreError(
            f"{self.place} is missing or empty: it alone records what was issued and revoked",
            hint="restore it from a backup; without one, see docs/reference/keystore.md, Backups",
        )


def check(private: Folder, *, begin: bool) -> None:
    """KeystoreError or PermissionError if no lines could be added now."""
    _ledger_file.check(private)
    Ledger(FileStore(private, begin=begin)).close()


def refuse_full(private: Folder, entries: Sequence[Entry], *, begin: bool) -> None:
    """TooLargeError if the file would be too large to be read with these lines."""
    limit = _ledger_file.limit_for(entries)
    if _ledger_file.most_with(private, entries) > limit:
        with Ledger(FileStore(private, begin=begin)) as ledger:
            ledger.append(entries)
            _ledger_file.refuse_larger(ledger.file_size, limit)


def add(private: Folder, entries: Iterable[Entry], beside: Folder, *, begin: bool) -> None:
    """Add lines to the ledger, all or none, with a temporary file in the folder `beside`.

    May be repeated. KeystoreError if there is no ledger, unless `begin`.
    """
    _ledger_file.check(private)
    if begin or private.kind(layout.LEDGER) is not None:  # the log of a lost ledger is kept
        _ledger_file.settle(private, beside)
    with Ledger(FileStore(private, begin=begin)) as ledger:
        ledger.append(entries)
        _ledger_file.save(private, ledger.to_file(), beside)
        ledger.is_stored(FileStore(private))
