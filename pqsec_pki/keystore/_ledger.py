"""The ledger: every certificate, signed document and revocation of this keystore."""

import json
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from typing import Any, Self, TypeAlias

from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _copies, _table, layout
from pqsec_pki.keystore._chain import OF_A_SET, SET, SET_END, Entry, Line
from pqsec_pki.keystore._store import MAX_TEXT, LedgerStore

_DETAIL = "CASE WHEN json_valid(details) THEN json_extract(details, '$.{}') END"
_SET = f"ifnull({_DETAIL.format(SET)}, '')"
"""The set that a line is about: the lines of the first set do not name it."""
_OWN = f" AND {_SET} = :set AND number > :since"
"""Of the set that is asked about, and not of an earlier one with its name, which was removed."""
_PARTICIPANTS = (  # beside max(), SQLite takes the other columns from the row that has it
    "WITH certified AS (SELECT max(number) AS number, name, sha256, at,"  # noqa: S608 -- no outside text
    " ifnull(not_after, '') AS not_after, ifnull(serial, '') AS serial,"
    " ifnull(issuer, '') AS issuer,"
    f" count({_DETAIL.format('request')}) AS requests,"
    f" CAST({_DETAIL.format('profile')} AS TEXT) AS profile,"
    f" CAST({_DETAIL.format('domains')} AS TEXT) AS domains,"
    f" ifnull(CAST({_DETAIL.format('keys')} AS TEXT), '') AS keys,"
    f" ifnull(CAST({_DETAIL.format('mark')} AS TEXT), '') AS mark"
    f" FROM ledger WHERE kind = 'participant'{{chosen}}{_OWN} GROUP BY name),"
    " signed AS (SELECT max(number) AS number, name, sha256,"
    f" CAST({_DETAIL.format('domains')} AS TEXT) AS domains,"
    f" nullif(CAST({_DETAIL.format('mark')} AS TEXT), '') AS mark"
    f" FROM ledger WHERE kind = 'permissions'{{chosen}}{_OWN} GROUP BY name)"
    " SELECT certified.name, certified.sha256, serial, at, not_after, issuer, requests, profile,"
    " ifnull(signed.domains, certified.domains), keys,"
    " ifnull(CASE WHEN signed.number > certified.number THEN signed.mark END, certified.mark),"
    " ifnull(signed.sha256, ''), ifnull(signed.number, 0), EXISTS (SELECT 1 FROM ledger"
    " WHERE kind = 'revocation' AND sha256 = certified.sha256)"
    " FROM certified LEFT JOIN signed ON signed.name = certified.name ORDER BY certified.name"
)
_CHOSEN = " AND name IN (SELECT value FROM json_each(:names))"
_REVOKED_FOR = (
    "kind = 'participant' AND sha256 IN (SELECT sha256 FROM ledger"  # noqa: S608 -- see above
    f" WHERE kind IN ('revocation', 'compromise') AND {_DETAIL.format('reason')} = ?)"
    " ORDER BY number"
)
_KEYS_AFTER = (
    f"SELECT number, ifnull(CAST({_DETAIL.format('keys')} AS TEXT), '')"  # noqa: S608 -- see above
    f" || ' ' || ifnull(CAST({_DETAIL.format('key_parts')} AS TEXT), '')"
    " FROM ledger WHERE +kind = 'participant' AND number > ?"
)
"""The + keeps SQLite from the index of kinds, so that only the lines after that one are read."""
_CERTIFIED = (
    f"SELECT key, name, {_SET}, sha256"  # noqa: S608 -- see above
    " FROM temp.certified JOIN ledger USING (number)"
    " WHERE key IN (SELECT value FROM json_each(?)) AND not_after >= ? ORDER BY number"
)
_REPLACED = (
    f"SELECT number, {_table.COLUMNS} FROM ledger WHERE kind = 'participant' AND not_after >= :at"  # noqa: S608 -- no outside text
    f"{_OWN} AND NOT EXISTS (SELECT 1 FROM ledger AS ended"
    " WHERE ended.kind = 'revocation' AND ended.sha256 = ledger.sha256)"
    " AND EXISTS (SELECT 1 FROM ledger AS newer WHERE newer.kind = 'participant'"
    f" AND newer.name = ledger.name AND newer.number > ledger.number"
    f"{_OWN.replace('details', 'newer.details')}) ORDER BY number"
)


_ENDED = f"SELECT ifnull(max(number), 0) FROM ledger WHERE kind = '{SET_END}' AND {_SET} = ?"  # noqa: S608 -- no outside text
_SETS = (
    f"SELECT {_SET} AS own FROM ledger WHERE kind IN ('identity-ca', '{SET_END}')"  # noqa: S608 -- see above
    f" GROUP BY own HAVING max(CASE kind WHEN '{SET_END}' THEN number ELSE 0 END)"
    " < max(CASE kind WHEN 'identity-ca' THEN number ELSE 0 END)"
)
_SIZE = "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size"
Row: TypeAlias = tuple[int, str, str, str, str]
"""Number, kind, name, SHA-256 and chain value of a line."""
ABOVE = "above"
"""The detail of the first line for that number."""
PLACE = "place"
"""The detail with the folder in the keystore, of a document that was signed into it by hand."""
_ORIGIN = 32
"""Hexadecimal digits of a chain value that name a ledger."""


class Ledger:
    """A copy in memory of the lines in a store, as of its creation.

    Questions by kind, or by kind and name, are about the lines of one set of credentials, if lines
    of that kind are of a set; all others are about all lines.
    """

    def __init__(self, store: LedgerStore, set_name: str = layout.FIRST) -> None:
        """Load it; KeystoreError if it is missing there, or is not a ledger."""
        self._place, self.set_name = store.place, set_name
        with self._errors("not a ledger: "):
            self._open: _copies.LedgerCopy | None = _updated(store) or _loaded(store)
            _copies.share(self._open)

    @property
    def _copy(self) -> _copies.LedgerCopy:
        if self._open is None:
            raise RuntimeError("the ledger is closed")
        return self._open

    @property
    def _database(self) -> sqlite3.Connection:
        return self._copy.database

    def of(self, set_name: str) -> Self:
        """The same lines, for questions about that set; until this one is closed."""
        found = copy(self)
        found.set_name = set_name
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the memory, or keep the lines that the store has for the next question."""
        copy, self._open = self._open, None
        if copy:
            if copy.database.in_transaction:
                copy.database.execute("ROLLBACK")
            _copies.give_back(copy)

    def append(self, entries: Iterable[Entry]) -> None:
        """Add these lines in memory, all or none; existing lines are skipped."""
        with self._errors():
            self._open = _copies.to_change(self._copy)
        with self._errors(), _table.part_of_change(self._database):
            _table.append(self._database, entries)

    def stored(self, *, after: int = 0) -> list[tuple[Any, ...]]:
        """The lines after number `after` as a store keeps them: the rows of `_table.rows`."""
        with self._errors():
            return list(_table.rows(self._database, after=after))

    def to_file(self) -> bytes:
        """The lines as an SQLite database."""
        with self._errors():
            if self._database.in_transaction:
                self._database.execute("COMMIT")
                self._copy.key = None
            return self._database.serialize()

    @property
    def file_size(self) -> int:
        """The size of the result of `to_file`, in bytes."""
        with self._errors():
            return self._number(_SIZE)

    def is_stored(self, store: LedgerStore) -> None:
        """Record that the store now has the result of `to_file`."""
        self._copy.key = store.key

    def fits(self, head: bytes) -> bool:
        """Whether `is_found_to_fit` was called with that signed head, for a copy of this ledger."""
        return self._copy.fits == head

    def is_found_to_fit(self, head: bytes) -> None:
        """Record that it has the lines of which that head was signed."""
        self._copy.fits = head

    @property
    def head(self) -> str:
        """The chain value of the last line."""
        with self._errors():
            return _table.last(self._database)[1]

    @property
    def size(self) -> int:
        """The number of the last line; 0 if there is none."""
        with self._errors():
            return _table.last(self._database)[0]

    @property
    def above(self) -> int:
        """The largest sequence number of a ledger that was lost before this one began; 0 if none
        was."""
        first = self._find("number = 1", ())
        text = first[0].details.get(ABOVE, "") if first else ""
        return int(text) if text.isdecimal() else 0

    @property
    def origin(self) -> str:
        """The name of this ledger in its heads, by the chain value of its first line."""
        with self._errors():
            rows = self._database.execute("SELECT chain FROM ledger WHERE number = 1")
            return f"pqsec-ledger/{(rows.fetchone() or ('',))[0][:_ORIGIN]}"

    def rows(self, *, after: int = 0) -> Iterator[Row]:
        """The values that the tree hashes, for the lines after number `after`, oldest first."""
        with self._errors():
            yield from self._database.execute(
                "SELECT number, kind, name, sha256, chain FROM ledger"
                " WHERE number > ? ORDER BY number",
                (after,),
            )

    def lines(self) -> Iterator[Line]:
        """All lines, oldest first."""
        with self._errors():
            rows = self._database.execute(
                f"SELECT number, chain, {_table.COLUMNS} FROM ledger ORDER BY number"  # noqa: S608
            )
            yield from map(_table.line, rows)

    def of_kind(self, *kinds: str) -> list[Entry]:
        """The entries of these kinds, oldest first."""
        return self._own(kinds, "ORDER BY number")

    def of_name(self, kind: str, name: str) -> list[Entry]:
        """The entries of that kind and name, oldest first."""
        return self._own([kind], "AND name = :name ORDER BY number", name=name)

    def placed(self, kind: str) -> dict[str, Entry]:
        """The newest entry of that kind for each folder into which one was signed by hand."""
        place = _DETAIL.format(PLACE)
        found = self._own([kind], f"AND {place} IS NOT NULL ORDER BY number")
        return {str(each.details[PLACE]): each for each in found}

    def last_of(self, *kinds: str) -> Entry | None:
        """The newest entry of these kinds, in any set; None if there is none."""
        marks = ", ".join("?" for _ in kinds)
        # The + keeps SQLite from the index of kinds, by which it would sort all their lines.
        found = self._find(f"+kind IN ({marks}) ORDER BY number DESC LIMIT 1", kinds)
        return next(iter(found), None)

    def count(self, kind: str, name: str) -> int:
        """The number of lines of that kind and name."""
        return self._number(
            f"SELECT count(*) FROM ledger WHERE {self._condition([kind])} AND name = :name",  # noqa: S608 -- no outside text
            {"kind0": kind, "name": name, **self._about},
        )

    def line_of(self, kinds: Collection[str], sha256: str) -> int:
        """The number of the newest line of these kinds with that SHA-256; 0 if there is none."""
        marks = ", ".join("?" for _ in kinds)
        return self._number(
            f"SELECT ifnull(max(number), 0) FROM ledger WHERE kind IN ({marks}) AND sha256 = ?",  # noqa: S608 -- no outside text
            (*kinds, sha256),
        )

    def row(self, number: int) -> Row | None:
        """The values that the tree hashes, for line `number`; None without that line."""
        return next((each for each in self.rows(after=number - 1) if each[0] == number), None)

    def line(self, number: int) -> Line | None:
        """Line `number`; None without that line."""
        query = f"SELECT number, chain, {_table.COLUMNS} FROM ledger WHERE number = ?"  # noqa: S608 -- no outside text
        with self._errors():
            found = self._database.execute(query, (number,)).fetchone()
            return _table.line(found) if found else None

    def newest(self, kind: str) -> list[Entry]:
        """The newest entry of that kind for each name."""
        own = self._condition([kind])
        return self._find(
            f"number IN (SELECT max(number) FROM ledger WHERE {own} GROUP BY name)",  # noqa: S608 -- no outside text
            {"kind0": kind, **self._about},
        )

    def replaced(self, at: str) -> list[tuple[int, Entry]]:
        """The certificates that end at `at` or later and were not revoked, of participants that
        got another one since, with the numbers of their lines; oldest first."""
        with self._errors():
            rows = self._database.execute(_REPLACED, {"at": at, **self._about})
            return [(number, _table.entry(row)) for number, *row in rows]

    def revoked_for(self, reason: str) -> list[Entry]:
        """The entries of participants whose certificates were revoked for that reason."""
        return self._find(_REVOKED_FOR, (reason,))

    def issued(self) -> dict[str, str]:
        """The participant of each certificate, by its SHA-256."""
        with self._errors():
            rows = self._database.execute(
                "SELECT sha256, name FROM ledger WHERE kind = 'participant'"
            )
            return dict(rows.fetchall())

    def certified(self, keys: Iterable[str], until: str) -> list[tuple[str, str, str, str]]:
        """Key, name, set and SHA-256 of each certificate for these keys, in any set, that ends at
        `until` or later.

        `keys` are hashes, as of `all_hashes`.
        """
        with self._errors():
            last = _table.begin_keys(self._database)
            rows = self._database.execute(_KEYS_AFTER, (last,))
            _table.add_keys(self._database, rows)
            asked = json.dumps(list(keys)), until
            return self._database.execute(_CERTIFIED, asked).fetchall()

    def participants(self, names: Collection[str] | None = None) -> Iterator[tuple[Any, ...]]:
        """The content of the newest lines of each participant, or each in `names`, sorted by name.

        Name; SHA-256, serial, time, end and issuer of its newest certificate; how many requests
        were answered; profile, domains, keys and config digest; SHA-256 and line number of the
        newest permissions; whether the certificate was revoked. Missing texts are empty, profile
        and domains None.
        """
        query = _PARTICIPANTS.replace("{chosen}", "" if names is None else _CHOSEN)
        with self._errors():
            chosen = {"names": json.dumps(list(names or ())), **self._about}
            yield from self._database.execute(query, chosen)

    def numbers(self, kind: str) -> dict[str, int]:
        """The line numbers of that kind, by SHA-256."""
        with self._errors():
            rows = self._database.execute(
                f"SELECT sha256, number FROM ledger WHERE {self._condition([kind])}",  # noqa: S608 -- no outside text
                {"kind0": kind, **self._about},
            )
            return dict(rows.fetchall())

    def sets(self) -> set[str]:
        """The names of the sets of credentials that have CAs, and were not removed since."""
        with self._errors():
            return {str(each) for (each,) in self._database.execute(_SETS)}

    def _own(self, kinds: Sequence[str], others: str, **values: str) -> list[Entry]:
        """The entries of these kinds, of this set if they are of one, and of `others`."""
        numbered = {f"kind{number}": each for number, each in enumerate(kinds)}
        return self._find(
            f"{self._condition(kinds)} {others}", {**numbered, **values, **self._about}
        )

    @property
    def _about(self) -> dict[str, Any]:
        """The values of `_OWN`: the set, and the line that ended an earlier one of its name."""
        ended = self._number(_ENDED, (self.set_name,)) if self.set_name else 0
        return {"set": self.set_name, "since": ended}

    @staticmethod
    def _condition(kinds: Sequence[str]) -> str:
        marks = ", ".join(f":kind{number}" for number in range(len(kinds)))
        return f"kind IN ({marks}){'' if OF_A_SET.isdisjoint(kinds) else _OWN}"

    def _number(self, query: str, values: Sequence[str] | Mapping[str, Any] = ()) -> int:
        with self._errors():
            found: int = self._database.execute(query, values).fetchone()[0]
            return found

    def _find(self, condition: str, values: Sequence[str] | Mapping[str, Any]) -> list[Entry]:
        with self._errors():
            rows = self._database.execute(
                f"SELECT {_table.COLUMNS} FROM ledger WHERE {condition}",  # noqa: S608
                values,
            )
            return [_table.entry(row) for row in rows]

    @contextmanager
    def _errors(self, otherwise: str = "") -> Iterator[None]:
        """Turn errors of the database into KeystoreError."""
        try:
            yield
        except (sqlite3.Error, ValueError, TypeError, OverflowError, RecursionError) as error:
            raise KeystoreError(
                f"{self._place}: {otherwise}{error}", hint="restore it from a backup"
            ) from error


def _updated(store: LedgerStore) -> _copies.LedgerCopy | None:
    """The last copy, with all lines of the store; None if there is none of it."""
    copy = _copies.take(store.key)
    if copy and not store.update(copy.database):
        copy.key = None
        _copies.give_back(copy)
        return None
    return copy


def _loaded(store: LedgerStore) -> _copies.LedgerCopy:
    copy = _copies.LedgerCopy.new(store.key)
    try:
        copy.database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_TEXT)
        store.load(copy.database)
    except BaseException:
        copy.database.close()
        raise
    return copy
