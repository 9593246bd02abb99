"""Which keystores have their ledger in a database, and the connection of the change that is made.

A thread that changes such a keystore asks and writes by one connection; others by one of their own.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _settings, layout
from pqsec_pki.keystore._address import LedgerAddress
from pqsec_pki.keystore._folder import Folder

if TYPE_CHECKING:
    from pqsec_pki.keystore._postgres import PostgresLedger


class _Connections(threading.local):
    """Those of this thread, by process and keystore; a fork has none."""

    def __init__(self) -> None:
        self.open: dict[tuple[int, Path], PostgresLedger] = {}


_connections = _Connections()


def connected(address: LedgerAddress) -> "PostgresLedger":
    """A new connection; KeystoreError if the database does not answer, or psycopg is missing."""
    try:
        from pqsec_pki.keystore._postgres import PostgresLedger  # noqa: PLC0415 -- few need it
    except ImportError:
        raise KeystoreError(
            f"{address.place}: the library for PostgreSQL is not installed",
            hint="install pqsec with its extra: pip install 'pqsec[postgres]'",
        ) from None
    return PostgresLedger(address)


@contextmanager
def reading(root: Path, folder: Folder) -> "Iterator[PostgresLedger | None]":
    """The database with the ledger of the keystore at `root`; None if it is in a file.

    KeystoreError if another user could have written the address.
    """
    if open_one := _connections.open.get((os.getpid(), root)):
        yield open_one
    elif address := _settings.read_ledger(root / layout.SETTINGS):
        folder.refuse_outsiders()
        with connected(address) as connection:
            yield connection
    else:
        yield None


@contextmanager
def writing(
    root: Path, address: LedgerAddress | None = None, *, hold: bool = False
) -> "Iterator[PostgresLedger | None]":
    """The same, for who has locked the keystore: no other machine adds lines meanwhile.

    With `address` it is that database, whatever the settings say. With `hold` the block may make
    any number of changes.
    """
    this = (os.getpid(), root)
    if this in _connections.open and address is None:
        with _excluding(_connections.open[this], hold=hold) as connection:
            yield connection
        return
    wanted = address or _settings.read_ledger(root / layout.SETTINGS)
    if wanted is None:
        yield None
        return
    with connected(wanted) as connection:
        if address is None:
            _connections.open[this] = connection
        try:
            if hold:
                connection.hold()
            with _excluding(connection, hold=hold):
                yield connection
        finally:
            if address is None:
                del _connections.open[this]


@contextmanager
def _excluding(connection: "PostgresLedger", *, hold: bool) -> "Iterator[PostgresLedger]":
    if hold:  # the block's changes are transactions of their own
        yield connection
    else:
        with connection.change():
            yield connection
