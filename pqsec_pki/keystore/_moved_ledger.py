"""The lines about a move of the ledger, and the lines that are moved."""

import hashlib
from datetime import datetime
from itertools import zip_longest
from typing import TYPE_CHECKING

from pqsec_pki._times import said
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger

if TYPE_CHECKING:
    from pqsec_pki.keystore._postgres import PostgresLedger
    from pqsec_pki.keystore._store import LedgerStore

KIND, _FILE = "ledger", "sqlite"


def moved_entry(head: str, place: str, now: datetime) -> Entry:
    """The line with which a ledger goes to `place`; `head` makes it another line each time."""
    sha256 = hashlib.sha256(f"{head} {place}".encode()).hexdigest()
    return Entry.of(KIND, "", sha256, now, details={"moved to": place})


def refuse_moved(store: "LedgerStore") -> None:
    """KeystoreError if the last line in a database says that the ledger went to a file."""
    with Ledger(store) as ledger:
        moved, size = ledger.of_kind(KIND), ledger.size
        last = ledger.numbers(KIND)
    if moved and last[moved[-1].sha256] == size and moved[-1].details.get("moved to") == _FILE:
        raise KeystoreError(
            f"{store.place}: on {said(moved[-1].made_at)} the ledger was moved to a file of one"
            f" keystore, by {moved[-1].operator}",
            hint="work on that machine, or move it back there with `pqsec ledger move`",
        )


def take_over(database: "PostgresLedger", here: Ledger) -> bool:
    """Put the lines of `here` into the database; False if it has newer ones beside them.

    They are read back. KeystoreError if it has another ledger.
    """
    with Ledger(database) as there:
        size = there.size
        _refuse_other(database.place, there, here, least=min(size, here.size))
    if size > here.size:
        refuse_moved(database)
        return False
    database.add(here.stored(after=size))
    with Ledger(database) as there:
        _refuse_other(database.place, there, here, least=here.size)
    return True


def _refuse_other(place: str, there: Ledger, here: Ledger, *, least: int) -> None:
    """KeystoreError unless the first `least` lines are the same, column by column."""
    pairs = zip_longest(there.stored()[:least], here.stored()[:least])
    for number, (one, other) in enumerate(pairs, 1):
        if one != other:
            raise KeystoreError(
                f"{place} has the ledger of another keystore: line {number} differs",
                hint="name another database",
            )
