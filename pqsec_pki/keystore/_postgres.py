"""A ledger in PostgreSQL, for keystores on several machines. The only user of psycopg.

One row of the database is locked by who adds lines, from before the first question until the
commit, so lines are numbered and chained as with one machine. A lock of a row ends with its
transaction: who makes several changes holds it with a second connection.
"""

import os
import socket
import sqlite3
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Self

import psycopg
from psycopg import errors
from psycopg.conninfo import make_conninfo

from pqsec_pki.errors import KeystoreError, other_format, shown
from pqsec_pki.keystore import _ledger_file, _postgres_schema, _table
from pqsec_pki.keystore._address import LedgerAddress
from pqsec_pki.keystore._copies import CopyKey

_LOCK = "SELECT FROM pqsec.writing FOR UPDATE"
_HOLDERS = (
    "SELECT DISTINCT usename, application_name FROM pg_locks JOIN pg_stat_activity USING (pid)"
    " WHERE relation = 'pqsec.writing'::regclass AND mode = 'RowShareLock' AND granted"
    " AND pid != pg_backend_pid() AND NOT EXISTS (SELECT FROM pg_locks AS waiting"
    " WHERE waiting.pid = pg_locks.pid AND NOT waiting.granted)"
)
"""Who has the lock: a reader of pg_locks sees it, and waits for nothing."""
_LONGEST_NAME = 63
"""Octets of a connection's name that PostgreSQL keeps."""
_CONNECTION = {
    "client_encoding": "utf8",
    "target_session_attrs": "read-write",  # a standby may lack the newest revocation
    "keepalives_idle": "30",
    "keepalives_interval": "10",
    "keepalives_count": "3",
    "tcp_user_timeout": "60000",
}
_SESSION = {
    "lock_timeout": "30s",  # as long as for another command on this machine
    "idle_in_transaction_session_timeout": "0",  # a change may sign for minutes
    "tcp_keepalives_idle": "30",  # a machine that lost its power gives the lock back
    "tcp_keepalives_interval": "10",
    "tcp_keepalives_count": "3",
    "search_path": "pg_catalog",
    "DateStyle": "ISO",
}
_SESSION_SQL = (
    "SELECT "
    + ", ".join(f"set_config('{name}', '{value}', false)" for name, value in _SESSION.items())
    + ", set_config('synchronous_commit', CASE current_setting('synchronous_commit')"
    " WHEN 'off' THEN 'on' ELSE current_setting('synchronous_commit') END, false)"
)
_COLUMNS = f"number, {_table.COLUMNS}, chain"
_SELECT = f"SELECT {_COLUMNS} FROM pqsec.ledger WHERE number >= %s ORDER BY number LIMIT %s"  # noqa: S608 -- no outside text
_COPY = f"COPY pqsec.ledger ({_COLUMNS}) FROM STDIN"
_KEEP = "INSERT INTO pqsec.files (sha256, content) VALUES (%s, %s) ON CONFLICT DO NOTHING"
_STATE = "SELECT current_setting('transaction_read_only'), (SELECT max(version) FROM pqsec.format)"
_KEPT = "SELECT sha256, content FROM pqsec.files WHERE sha256 = ANY(%s)"
_WAITING = "SELECT sha256, known, asked FROM pqsec.waiting"
_WAITING_CONTENT = "SELECT request FROM pqsec.waiting WHERE sha256 = %s"
_ASK_AGAIN = "UPDATE pqsec.waiting SET asked = %s WHERE sha256 = %s"
_PUT_WAITING = (
    "INSERT INTO pqsec.waiting (sha256, known, asked, request) VALUES (%s, %s, %s, %s)"
    " ON CONFLICT DO NOTHING"
)
_REMOVE_WAITING = "DELETE FROM pqsec.waiting WHERE sha256 = ANY(%s)"
_MODE, _VERIFIED = "PGSSLMODE", "verify-full"
_BATCH = 5000
"""Rows of one answer."""
_LONGEST = 60.0
"""Seconds after which a new connection replaces it: the name may lead to another server by then,
and the role or its password may have changed."""
_NOTHING = "nothing was changed: run the command again when the database answers"
_GUIDE = "docs/how-to/postgresql.md"


class PostgresLedger:
    """A connection to the ledger's database; closed, it opens again for no question."""

    def __init__(self, address: LedgerAddress) -> None:
        """KeystoreError if it does not answer, or has no ledger of this version."""
        self.address = address
        self._made = time.monotonic()
        self._in_change = False
        self._holder: psycopg.Connection[Any] | None = None
        """The connection that holds the lock for several changes; it stays open between holds."""
        self._holds = False
        self._newest: tuple[int, str] | None = None
        """The last line, while other writers are excluded and none was added."""
        self._connection = self._connected()
        try:
            with self._errors():
                self._refuse_format()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _connected(self) -> psycopg.Connection[Any]:
        with self._errors(), _service_verified(self.address):
            made = psycopg.connect(
                make_conninfo(self.address.url, **_defaults(self.address)),
                autocommit=True,
                prepare_threshold=None,
            )
        try:
            with self._errors():
                made.execute(_SESSION_SQL)
        except BaseException:
            made.close()
            raise
        return made

    def close(self) -> None:
        """Give back the locks; what was not committed is dropped."""
        for each in (self._holder, self._connection):
            if each:
                with suppress(psycopg.Error):
                    each.close()

    def serves(self, address: LedgerAddress) -> bool:
        """Whether it is a connection to `address`, which may still write to the same format."""
        if self.address != address or time.monotonic() - self._made > _LONGEST:
            return False
        try:
            if self._holder:
                self._holder.execute("SELECT 1")
            found = self._connection.execute(_STATE).fetchone()
        except psycopg.Error:
            return False
        return found == ("off", _postgres_schema.FORMAT)

    @property
    def place(self) -> str:
        """Its address, for messages."""
        return self.address.place

    @property
    def key(self) -> CopyKey:
        """Lines are only added: for a copy, only the newer ones are read."""
        return CopyKey(self.address.url)

    def update(self, database: sqlite3.Connection) -> bool:
        """Add the newer lines, within a change as they are for it."""
        last = _table.last(database)
        if last == self._newest:
            return True
        with self._errors():
            rows = self._rows(last[0])
            first = next(rows, None)
            if first is None or (first[0], first[-1]) != last:
                return False
            _table.extend(database, rows)
        self._note(database)
        return True

    def load(self, database: sqlite3.Connection) -> None:
        """All lines; within a change as they are for it."""
        pages = database.execute("PRAGMA page_size").fetchone()[0]
        database.execute(f"PRAGMA max_page_count = {_ledger_file.MAX_SIZE // pages}")
        with self._errors():
            _table.fill(database, self._rows())
        self._note(database)

    def _note(self, database: sqlite3.Connection) -> None:
        if self._in_change or self._holds:
            self._newest = _table.last(database)

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Exclude other writers, for any number of changes. After an error the caller closes the
        connection."""
        if self._holder is None or self._holder.closed:
            self._holder = self._connected()
        with self._errors():
            self._holder.execute("BEGIN")
            self._holder.execute(_LOCK)
        self._holds = True
        yield
        self._holds, self._newest = False, None
        with suppress(psycopg.Error):
            self._holder.execute("ROLLBACK")
            return
        self.close()  # which gives the lock back, too

    @contextmanager
    def change(self) -> Iterator[None]:
        """Exclude other writers; what is not committed in the block is dropped."""
        with self._errors():
            self._connection.execute("BEGIN")
            if not self._holds:
                self._connection.execute(_LOCK)
        self._in_change = True
        try:
            yield
        finally:
            self._in_change, self._newest = False, None
            with suppress(psycopg.Error):
                if self._connection.info.transaction_status:
                    self._connection.execute("ROLLBACK")

    def add(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Add lines, in rows of number, columns and chain value; `commit` makes them stay."""
        self._newest = None
        with self._errors(), self._connection.cursor() as cursor, cursor.copy(_COPY) as copy:
            for row in rows:
                copy.write_row(row)

    def keep(self, files: Iterable[tuple[str, bytes]]) -> None:
        """Keep these files, each under the SHA-256 of its line; `commit` makes them stay."""
        with self._errors(), self._connection.cursor() as cursor:
            cursor.executemany(_KEEP, files)

    def kept(self, wanted: Collection[str]) -> dict[str, bytes]:
        """The files with these SHA-256, as far as they are there; their content is not checked."""
        with self._errors():
            return dict(self._connection.execute(_KEPT, (list(wanted),)).fetchall())

    def waiting(self) -> list[tuple[str, str, str]]:
        """The waiting requests: SHA-256, what is known, and when they were last sent."""
        with self._errors():
            return self._connection.execute(_WAITING).fetchall()

    def waiting_content(self, sha256: str) -> bytes | None:
        """The octets of that request; None if it does not wait."""
        with self._errors():
            found = self._connection.execute(_WAITING_CONTENT, (sha256,)).fetchone()
        return found[0] if found else None

    def ask_again(self, sha256: str, asked: str) -> bool:
        """Whether that request waits; if so, it was last sent then."""
        with self._errors():
            return self._connection.execute(_ASK_AGAIN, (asked, sha256)).rowcount > 0

    def put_waiting(self, sha256: str, known: str, asked: str, content: bytes) -> None:
        """Add a request, unless it waits."""
        with self._errors():
            self._connection.execute(_PUT_WAITING, (sha256, known, asked, content))

    def remove_waiting(self, ids: Collection[str]) -> None:
        """Drop the requests with these SHA-256, as far as they are there."""
        with self._errors():
            self._connection.execute(_REMOVE_WAITING, (list(ids),))

    def commit(self) -> None:
        """End the change. After a KeystoreError only `has` shows whether it was committed."""
        with self._errors():
            if self._holds and self._holder:
                self._holder.execute("SELECT 1")  # who lost the lock adds no line
            if self._connection.execute("COMMIT").statusmessage != "COMMIT":
                raise KeystoreError(f"{self.place}: the change was refused", hint=_NOTHING)

    def has(self, number: int, chain: str) -> bool:
        """Whether line `number` is the one with that chain value."""
        with self._errors():
            found = self._connection.execute(
                "SELECT chain FROM pqsec.ledger WHERE number = %s", (number,)
            ).fetchone()
        return found == (chain,)

    def _rows(self, number: int = 0) -> Iterator[tuple[Any, ...]]:
        """Line `number` and those after it. Lines are only added, so the answers fit together."""
        while True:
            rows = self._connection.execute(_SELECT, (number, _BATCH)).fetchall()
            yield from rows
            if len(rows) < _BATCH:
                return
            number = rows[-1][0] + 1

    def _refuse_format(self) -> None:
        [(found,)] = self._connection.execute("SELECT max(version) FROM pqsec.format").fetchall()
        if not isinstance(found, int) or found > _postgres_schema.FORMAT:
            known = (_postgres_schema.FORMAT,)
            raise other_format(KeystoreError, found, known, where=self.place)
        if found < _postgres_schema.FORMAT:
            raise _without_tables(f"{self.place}: made by an older pqsec (format {found})")

    def _who(self) -> str:
        """Who has the lock, in words; empty if it is free by now."""
        found: list[tuple[str, str]] = []
        with suppress(psycopg.Error), self._connected() as asking:
            found = asking.execute(_HOLDERS).fetchall()
        words = [f"{shown(name)} by role {shown(role)}" for role, name in found]
        return f": {', '.join(words)}" if words else ""

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn errors of the database and of the connection into KeystoreError."""
        try:
            yield
        except errors.LockNotAvailable:
            raise KeystoreError(
                f"{self.place}: another pqsec command is using this ledger{self._who()}",
                hint="run the command again when that has ended; if its machine lost the"
                " connection, the lock ends after a minute",
            ) from None
        except (errors.UndefinedTable, errors.InvalidSchemaName):
            raise _without_tables(f"{self.place} has no ledger") from None
        except errors.InsufficientPrivilege as error:
            raise KeystoreError(
                f"{self.place}: {_said(error)}", hint=f"{_GUIDE} has the rights that a role needs"
            ) from None
        except psycopg.Error as error:
            raise KeystoreError(f"{self.place}: {_said(error)}", hint=_NOTHING) from None


def _defaults(address: LedgerAddress) -> dict[str, str]:
    """Parameters that the address lacks; pqsec authenticates each server on another machine."""
    given = address.parameters
    name = f"pqsec on {socket.gethostname()}".encode("ascii", "replace")[:_LONGEST_NAME].decode()
    defaults = {**_CONNECTION, "application_name": name}
    found = {name: value for name, value in defaults.items() if name not in given}
    found["connect_timeout"] = given.get("connect_timeout", "10")
    if not address.is_local and not ("sslmode" in given or _has_service(address)):
        found["sslmode"] = os.environ.get(_MODE, _VERIFIED)
    return found


def _has_service(address: LedgerAddress) -> bool:
    return "service" in address.parameters or "PGSERVICE" in os.environ


@contextmanager
def _service_verified(address: LedgerAddress) -> Iterator[None]:
    """The mode for a service that says none: libpq reads the environment after the service file."""
    default = _has_service(address) and _MODE not in os.environ
    if default:
        os.environ[_MODE] = _VERIFIED
    try:
        yield
    finally:
        if default:
            del os.environ[_MODE]


def _without_tables(words: str) -> KeystoreError:
    hint = f"`pqsec ledger schema` writes the SQL that makes its tables: {_GUIDE}"
    return KeystoreError(words, hint=hint)


def _said(error: psycopg.Error) -> str:
    """The first line of what the server, or libpq, said."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return shown(lines[0], limit=300)
