"""Which keystores have their ledger in a database, and the connection of the change that is made.

A thread that changes such a keystore reads and writes with one connection; other threads have their
own. A server, which makes one change after another, keeps its connection between them.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._libraries import LIBRARIES
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _settings, layout
from pqsec_pki.keystore._address import LedgerAddress
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._outsiders import refuse_open_root

if TYPE_CHECKING:
    from pqsec_pki.keystore._postgres import PostgresLedger


class _Connections(threading.local):
    """The connections of this thread, by process and keystore; a fork has none."""

    def __init__(self) -> None:
        self.open: dict[tuple[int, Path], PostgresLedger] = {}
        self.spare: dict[tuple[int, Path], PostgresLedger] = {}
        """Without locks, for the next question or change."""


_connections = _Connections()


def connected(address: LedgerAddress) -> "PostgresLedger":
    """A new connection; KeystoreError if the database does not answer, or psycopg is missing."""
    try:
        from pqsec_pki.keystore._postgres import PostgresLedger  # noqa: PLC0415 -- few need it
    except ImportError:
        raise KeystoreError(
            f"{address.place}: the library for PostgreSQL is not installed",
            hint=LIBRARIES["psycopg"].hint,
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
        refuse_open_root(root)
        with _connection(root, address) as connection:
            yield connection
    else:
        yield None


@contextmanager
def _connection(
    root: Path, address: LedgerAddress, *, keep: bool = False
) -> "Iterator[PostgresLedger]":
    """A connection without locks: the spare one, or a new one, which `keep` makes the spare one."""
    this = (os.getpid(), root)
    spare = _connections.spare.pop(this, None)
    if spare and not spare.serves(address):
        spare.close()
        spare = None
    connection = spare or connected(address)
    try:
        yield connection
    except BaseException:
        connection.close()
        raise
    if spare or keep:
        _connections.spare[this] = connection
    else:
        connection.close()


@contextmanager
def writing(
    root: Path, address: LedgerAddress | None = None, *, hold: bool = False, keep: bool = False
) -> "Iterator[PostgresLedger | None]":
    """Like `reading`, for a caller that locked the keystore: no other machine can add lines.

    With `address` it is that database, whatever the settings say. With `hold` the block may make
    any number of changes, each a transaction of its own; with `keep` its connection stays open for
    the next one of this thread.
    """
    this = (os.getpid(), root)
    if this in _connections.open and address is None:
        with nullcontext() if hold else _connections.open[this].change():
            yield _connections.open[this]
        return
    wanted = address or _settings.read_ledger(root / layout.SETTINGS)
    if wanted is None:
        yield None
        return
    with _connection(root, wanted, keep=keep) as connection:
        if address is None:
            _connections.open[this] = connection
        try:
            with connection.hold() if hold else connection.change():
                yield connection
        finally:
            if address is None:
                del _connections.open[this]
