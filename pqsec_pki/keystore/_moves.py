"""The remaining steps of a committed change: recorded in its folder, and executed from there.

Each step may be repeated. Steps use descriptors: they follow no link and never leave the
keystore, even if somebody else wrote the journal.
"""

import errno
import json
import os
import posixpath
import secrets
import shutil
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, replace
from operator import attrgetter

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import PRIVATE_MODE, create, sync_filesystem
from pqsec_pki.errors import KeystoreError, TooLargeError, UsageError
from pqsec_pki.keystore import _file_store, _shredding, layout
from pqsec_pki.keystore._address import LedgerAddress
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._folder import Folder, should_be
from pqsec_pki.keystore._transaction import Transaction, refuse_detours
from pqsec_pki.keystore.layout import JOURNAL, MOVES, PREPARED

DRAFT = ".draft-"
_LINK = "link"
_VALUES = attrgetter(*(each.name for each in fields(Entry)))
_IN_THE_WAY = {errno.ENOTEMPTY, errno.EEXIST, errno.EBUSY, errno.EINVAL}
"""Errors of rename(2) for a folder that cannot replace another."""
_MAX_SIZE = 256 << 20
"""Bytes; the lines of 100,000 participants take 80 MB."""


@dataclass(frozen=True, slots=True)
class Commitment:
    """The line in a database whose presence means that the change is committed."""

    address: LedgerAddress
    number: int
    chain: str

    @classmethod
    def of(cls, value: Mapping[str, object]) -> "Commitment":
        address = LedgerAddress.parse(str(value["address"]))
        return cls(address, int(str(value["number"])), str(value["chain"]))


@dataclass(frozen=True, slots=True)
class _Moves:
    targets: list[str]
    """The targets of the folders 0, 1, ..."""
    links: list[tuple[str, str]]
    removed: list[str]
    emptied: list[str]
    """Folders that go if nothing is left in them."""
    entries: list[Entry]
    """The ledger's new lines."""
    begins_ledger: bool
    """Whether to create a missing ledger. Otherwise it was lost, and a new one would lack the
    revocations."""
    in_database: bool
    """Whether the lines are in a database, and not for the file."""
    commitment: Commitment | None

    @classmethod
    def read(cls, journal: Folder) -> "_Moves":
        path = f"{journal.path}/{MOVES}"
        with os.fdopen(_open(journal, path), "rb") as file:
            data = file.read(_MAX_SIZE)
        try:
            moves = json.loads(data)
            found = cls(
                [str(target) for target in moves["targets"]],
                [(str(place), str(target)) for place, target in moves.get("links", [])],
                [str(place) for place in moves.get("removed", [])],
                [str(folder) for folder in moves.get("emptied", [])],
                [_entry(each) for each in moves["entries"]],
                moves.get("begins_ledger") is True,
                moves.get("in_database") is True,
                Commitment.of(moves["commitment"]) if moves.get("commitment") else None,
            )
        except (UsageError, ValueError, KeyError, TypeError, RecursionError):
            raise _unreadable(path) from None
        places = (*found.targets, *(place for place, _ in found.links), *found.removed)
        places += tuple(found.emptied)
        shown = (posixpath.join(posixpath.dirname(place), to) for place, to in found.links)
        if not all(map(_is_inside, (*places, *map(posixpath.normpath, shown)))):
            raise _unreadable(path)
        return found


def write(transaction: Transaction) -> None:
    """Record the steps after the commit in the staged change's folder.

    TooLargeError if they could not be read again.
    """
    moves = {
        "targets": transaction.targets,
        "links": transaction.links,
        "removed": transaction.removed,
        "emptied": transaction.emptied,
        "entries": [_VALUES(entry) for entry in transaction.entries],
        "begins_ledger": transaction.begins_ledger,
        "in_database": transaction.database is not None,
        "commitment": _commitment(transaction),
    }
    data = json.dumps(moves).encode()
    hint = "change fewer participants at once: give names, or a part of the fleet"
    TooLargeError.check("the list of what to do", len(data), _MAX_SIZE, hint=hint)
    create(MOVES, data, mode=PRIVATE_MODE, folder=transaction.made.handle)


def _commitment(transaction: Transaction) -> dict[str, object] | None:
    if transaction.database is None or transaction.committed_by is None:
        return None
    number, chain = transaction.committed_by
    return {"address": transaction.database.address.url, "number": number, "chain": chain}


def prepared_change(root: Folder) -> Commitment | None:
    """How to learn whether the change that is prepared in `root` is committed; None without one.

    KeystoreError if it cannot be read, or another user owns it.
    """
    if root.kind(PREPARED) is None:
        return None
    with root.below(PREPARED) as prepared:
        prepared.refuse_outsiders()
        commitment = _Moves.read(prepared).commitment
        if commitment is None:
            raise _unreadable(f"{prepared.path}/{MOVES}")
        return commitment


def finish(root: Folder) -> None:
    """Execute the journal in `root`, if there is one.

    KeystoreError if it cannot be read, leads out of the keystore, or another user owns it.
    """
    if root.kind(JOURNAL) is None:
        return
    with root.below(JOURNAL) as journal:
        journal.refuse_outsiders()
        moves = _Moves.read(journal)
        others = (*(place for place, _ in moves.links), *moves.removed, *moves.emptied)
        refuse_detours(root, (*moves.targets, *map(os.path.dirname, others)))
        for number, target in enumerate(moves.targets):
            _move(journal, str(number), root, target)
        for place, target in moves.links:
            _link(journal, root, place, target)
        for place in moves.removed:
            _remove(root, place)
        for place in moves.emptied:
            _remove_empty(root, place)
        if moves.entries and not moves.in_database:
            with root.below(layout.PRIVATE) as private:
                _file_store.add(private, moves.entries, journal, begin=moves.begins_ledger)
        sync_filesystem(root.handle)
        _shredding.shred(journal)
    spent = f"{DRAFT}{secrets.token_hex(8)}"
    os.rename(JOURNAL, spent, src_dir_fd=root.handle, dst_dir_fd=root.handle)
    with suppress(OSError):  # else the next change removes it
        _remove_spent(root, spent)


def _remove_spent(root: Folder, spent: str) -> None:
    """Remove the executed journal, its moves last: until then `began` knows what it did."""
    with root.below(spent) as folder:
        for name in folder.names:
            if folder.kind(name) == stat.S_IFDIR:
                shutil.rmtree(name, dir_fd=folder.handle)
            elif name != MOVES:
                os.unlink(name, dir_fd=folder.handle)
    shutil.rmtree(spent, dir_fd=root.handle)


def began(root: Folder) -> bool:
    """Whether a killed command began a keystore in `root`, and committed that.

    It is recorded in the journal, executed or not; an executed one may be empty already.
    """
    ready = root.kind(layout.SETTINGS) is not None
    places = [each for each in root.names if each == JOURNAL or (ready and each.startswith(DRAFT))]
    for each in places:
        with root.below(each) as journal:
            journal.refuse_outsiders()
            if journal.kind(MOVES) is None:
                begun = each != JOURNAL and not journal.names
            else:
                begun = _Moves.read(journal).begins_ledger
            if begun:
                return True
    return False


def _move(journal: Folder, number: str, root: Folder, target: str) -> None:
    if journal.kind(number) != stat.S_IFDIR:
        return
    above, name = os.path.split(target)
    with root.below(above, make=True) as goal:
        try:  # succeeds if the target is missing or an empty folder
            os.rename(number, name, src_dir_fd=journal.handle, dst_dir_fd=goal.handle)
        except OSError as error:
            if error.errno not in _IN_THE_WAY:
                raise
            _merge(journal, number, goal, name)


def _merge(journal: Folder, number: str, above: Folder, name: str) -> None:
    with journal.below(number) as staged, above.below(name) as goal:
        mode = goal.mode & staged.mode
        if mode != goal.mode:  # never wider than before: the user may have restricted it
            os.fchmod(goal.handle, mode)
        # The certificate comes last: it makes the folder a participant.
        for each in sorted(staged.names, key=lambda name: (name == layout.CERTIFICATE, name)):
            os.replace(each, each, src_dir_fd=staged.handle, dst_dir_fd=goal.handle)
    os.rmdir(number, dir_fd=journal.handle)


def _link(journal: Folder, root: Folder, place: str, target: str) -> None:
    with suppress(FileNotFoundError):
        os.unlink(_LINK, dir_fd=journal.handle)
    os.symlink(target, _LINK, dir_fd=journal.handle)
    above, name = os.path.split(place)
    # No link is needed if the folder was removed meanwhile.
    with suppress(FileNotFoundError), root.below(above) as folder:
        os.replace(_LINK, name, src_dir_fd=journal.handle, dst_dir_fd=folder.handle)


def _remove(root: Folder, place: str) -> None:
    above, name = os.path.split(place)
    with suppress(FileNotFoundError), root.below(above) as folder:
        os.unlink(name, dir_fd=folder.handle)


def _remove_empty(root: Folder, place: str) -> None:
    above, name = os.path.split(place)
    with suppress(FileNotFoundError), root.below(above) as folder:
        try:
            os.rmdir(name, dir_fd=folder.handle)
        except OSError as error:  # what somebody else put there stays
            if error.errno not in {errno.ENOTEMPTY, errno.EEXIST, errno.ENOENT}:
                raise


def _entry(values: list[str]) -> Entry:
    entry = Entry(*values)  # type: ignore[arg-type] # as they were written
    return replace(entry, details=dict(entry.details))


def _is_inside(place: str) -> bool:
    return not ("\0" in place or place.startswith("/") or ".." in place.split("/"))


def _open(journal: Folder, path: str) -> int:
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    if journal.kind(MOVES) != stat.S_IFREG:
        raise should_be(path, "file") if journal.kind(MOVES) else _unreadable(path)
    return os.open(MOVES, flags, dir_fd=journal.handle)


def _unreadable(path: str) -> KeystoreError:
    return KeystoreError(f"{path}: this unfinished change cannot be read")
