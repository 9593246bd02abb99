"""Moves the ledger from its file into a database, and back; all lines stay as they are."""

from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.approvals import Covered
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import (
    Keystore,
    LedgerAddress,
    Transaction,
    change,
    layout,
    moved_entry,
    settings_file,
)

IN_A_FILE = "sqlite"
"""The name of the file, in place of an address."""


@dataclass(frozen=True, slots=True)
class LedgerMove:
    """The new address of a keystore's ledger."""

    place: str
    lines: int
    joined: bool
    """Whether the database had its lines before, and newer ones of another machine."""

    def to_json(self) -> dict[str, object]:
        """The result for --json."""
        return {"ledger": self.place, "lines": self.lines, "joined": self.joined}


def move_ledger(keystore: Keystore, target: LedgerAddress | None, *, now: datetime) -> LedgerMove:
    """Move the ledger into the database at `target`, or for None into the keystore's file.

    All lines are read back before the change is committed. A database that has these lines already,
    and newer ones, is joined: another machine moved the same ledger there. KeystoreError if the
    database has another ledger, or sets of credentials that are not here, or the ledger is there
    already.
    """
    source = keystore.ledger_address
    if source == target:
        raise KeystoreError("the ledger is there already")
    if source and target:
        raise KeystoreError(
            f"the ledger is in another database: {source.place}",
            hint=f"`pqsec ledger move {IN_A_FILE}` first; that closes it for all other machines",
        )
    with change(keystore.root, address=target) as transaction:
        keystore.refuse_unapproved(Covered.OTHER)
        settings = transaction.folder(".", private=False)
        settings.public(layout.SETTINGS, settings_file(keystore.profiles, keystore.domains, target))
        joined = _moved(keystore, target, transaction, now)
    with keystore.open_ledger() as ledger:
        return LedgerMove(target.place if target else IN_A_FILE, ledger.size, joined)


def _moved(
    keystore: Keystore, target: LedgerAddress | None, transaction: Transaction, now: datetime
) -> bool:
    """Stage the move; whether the database is joined."""
    with keystore.open_ledger() as ledger:
        head = ledger.head
        if target is None:
            transaction.record(moved_entry(head, IN_A_FILE, now))
            transaction.stage_ledger_file()
            return False
        joined = not transaction.take_over(ledger)
    if not joined:
        transaction.record(moved_entry(head, target.place, now))
    for name in layout.LEDGER_FILES:
        transaction.remove(f"{layout.PRIVATE}/{name}")
    return joined
