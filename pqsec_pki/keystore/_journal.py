"""Atomic changes to a keystore.

A change is staged in its own folder inside the keystore: every file is written and synced
first. Renaming that folder to `.journal` commits the change. Then the staged folders are
moved into place and the ledger is written. If the process is killed before the commit, the
next change removes the staged folder; if it is killed after the commit, the next command that
changes the keystore finishes the moves (`_moves.py`). A new participant's folder is moved
with one rename. A reader changes nothing, and refuses a keystore with unfinished moves.

If the ledger is in a database, its commit is that of the change: the staged folder is renamed to
`.prepared` first, and to `.journal` after it. If the process is killed between the two, the next
command asks the database for the change's last line: if that is there, the moves are finished;
if not, the staged folder is removed (ADR 29).

Links in existing folders are only recorded, and created during the moves: to add a link to
ten thousand enclaves, no enclave is staged.
"""

import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from pqsec_pki import _drafts
from pqsec_pki._files import disk_errors, sync_filesystem
from pqsec_pki._places import make_folders
from pqsec_pki.errors import FileError, InterruptedChangeError, KeystoreError
from pqsec_pki.keystore import _moves, _shared
from pqsec_pki.keystore._address import LedgerAddress
from pqsec_pki.keystore._fetched_files import newer_elsewhere, refuse_older_files, stage
from pqsec_pki.keystore._file_store import FileStore
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._lock import at_rest, locked
from pqsec_pki.keystore._moved_ledger import refuse_moved
from pqsec_pki.keystore._moves import DRAFT
from pqsec_pki.keystore._outsiders import refuse_open_keystore, refuse_open_root
from pqsec_pki.keystore._replaced_cas import refuse_replaced
from pqsec_pki.keystore._settings import set_names
from pqsec_pki.keystore._transaction import Transaction
from pqsec_pki.keystore.heads import compared
from pqsec_pki.keystore.layout import JOURNAL, PREPARED, PRIVATE, SEEN, SETTINGS, in_set

if TYPE_CHECKING:
    from pqsec_pki.keystore._postgres import PostgresLedger
    from pqsec_pki.keystore.authorities import Authorities

_LAST_FILES = 20
"""How often a folder is emptied again: forks of a killed command end soon after it."""


@contextmanager
def change(
    root: Path, authorities: "Authorities | None" = None, *, address: LedgerAddress | None = None
) -> Iterator[Transaction]:
    """Stage a change to the keystore at `root`; it is committed if the block raises no error.

    `authorities`, its CAs with their keys, sign the next head of the ledger. Only one process
    changes a keystore at a time. KeystoreError if another process locks it for half a minute, if
    another user owns it or may write there, or if the CAs have been replaced meanwhile;
    FileError for a disk error. The lines go into the database at `address`, if it is given.
    """
    with _disk_errors(root):
        refuse_open_root(root)
        make_folders(root, 0o755)
        with locked(root) as folder:
            _settle(folder)
            _sweep(folder)
            with _shared.writing(root, address) as database:
                if authorities:
                    authorities.refuse_outdated(root)
                if address is None:
                    _compare_ledger(folder, database)
                if database and address is None:
                    refuse_moved(database)
                    refuse_replaced(root, database)
                    _fetch(folder, database)
                name = f"{DRAFT}{secrets.token_hex(8)}"
                try:
                    os.mkdir(name, 0o700, dir_fd=folder.handle)
                    with folder.below(name) as made:
                        transaction = Transaction(
                            folder, made, authorities=authorities, database=database
                        )
                        yield transaction
                        _commit(transaction, name)
                except BaseException:
                    shutil.rmtree(name, ignore_errors=True, dir_fd=folder.handle)
                    raise
            _finish(folder)


@contextmanager
def hold(root: Path, *, keep_connection: bool = False) -> Iterator[None]:
    """Lock the keystore at `root` against other processes, after finishing any open change.

    The thread that holds the lock may make any number of changes. Errors as with `change`. With
    `keep_connection`, the connection to the ledger's database stays open for the next lock.
    """
    with _disk_errors(root), locked(root) as folder:
        _settle(folder)
        with _shared.writing(root, hold=True, keep=keep_connection):
            yield


def _compare_ledger(root: Folder, database: "PostgresLedger | None") -> None:
    """KeystoreError if the ledger, which the change extends, is not the one of the signed head."""
    if root.kind(SETTINGS) is None:  # a keystore that is created or adopted
        return
    with root.below(PRIVATE) as private:
        compared(Path(root.path), lambda: Ledger(database or FileStore(private))).close()


def _fetch(root: Folder, database: "PostgresLedger") -> None:
    """Get the governance and the list that other machines wrote, before a change uses them."""
    name = f"{DRAFT}{secrets.token_hex(8)}"
    if not newer_elsewhere(Transaction(root, root, database=database)):
        return
    try:
        os.mkdir(name, 0o700, dir_fd=root.handle)
        with root.below(name) as made:
            transaction = Transaction(root, made, database=database)
            stage(transaction, newer_elsewhere(transaction))
            _commit(transaction, name)
    except BaseException:
        shutil.rmtree(name, ignore_errors=True, dir_fd=root.handle)
        raise
    _moves.finish(root)


def recover(root: Path) -> bool:
    """Finish a change that was committed but not completed; True if there was one.

    One that was only prepared is dropped.

    Errors as with `change`.
    """
    if not is_interrupted(root):
        return False
    with _disk_errors(root), locked(root) as folder:
        return _settle(folder)


def resume(root: Path) -> bool:
    """Finish the change that began the keystore at `root`; True if there was an unfinished one.

    Also if only its temporary files were left. Errors as with `change`.
    """
    left = False
    with disk_errors(root), suppress(FileNotFoundError, NotADirectoryError):
        left = any(each.name.startswith((JOURNAL, DRAFT)) for each in root.iterdir())
    if not left:
        return False
    with _disk_errors(root), locked(root) as folder:
        began = _moves.began(folder)
        _settle(folder)
        _sweep(folder)
    return began


def check(root: Path) -> None:
    """KeystoreError if another user could change the keystore, or a folder above it."""
    with disk_errors(root), Folder.opened(root) as folder:
        folder.refuse_outsiders()
        refuse_open_keystore(root)


def refuse_interrupted(root: Path) -> None:
    """InterruptedChangeError if a change is unfinished; waits for a running command first.

    Nothing is altered. FileError for a disk error.
    """
    if is_interrupted(root):
        with disk_errors(root), suppress(FileNotFoundError), at_rest(root) as folder:
            if not {folder.kind(JOURNAL), folder.kind(PREPARED)} <= {None}:
                raise InterruptedChangeError(
                    f"{root}: a change was interrupted when it was half done",
                    hint=f"`pqsec -k {quote(str(root))} ca recover` finishes it",
                )


def is_interrupted(root: Path) -> bool:
    """Whether a change is unfinished, or at work.

    FileError names the keystore: no user knows the journal.
    """
    return any(_is_there(root, name) for name in (JOURNAL, PREPARED))


def _is_there(root: Path, name: str) -> bool:
    with disk_errors(root):
        try:
            (root / name).lstat()
        except FileNotFoundError:
            return False
        except OSError as error:
            error.filename = str(root)
            raise
    return True


def _settle(root: Folder) -> bool:
    """Finish or drop the change that a killed command left; True if one was finished."""
    finished = root.kind(JOURNAL) is not None
    _finish(root)
    if (commitment := _moves.prepared_change(root)) is None:
        return finished
    try:
        with _shared.connected(commitment.address) as database, database.change():
            # No other command is in its transaction now, also not the killed one.
            committed = database.has(commitment.number, commitment.chain)
    except KeystoreError as error:
        raise InterruptedChangeError(
            f"a change was interrupted during its commit, and only the database knows the outcome:"
            f" {error}",
            hint="run the command again, or `pqsec ca recover`, when the database answers",
        ) from error
    if committed:
        _rename(root, PREPARED, JOURNAL)
        _finish(root)
    else:
        _rename(root, PREPARED, f"{DRAFT}{secrets.token_hex(8)}")
        _sweep(root)
    return committed


def _finish(root: Folder) -> None:
    """Execute the journal, if there is one. FileError, with the way out, if the disk refuses."""
    try:
        _moves.finish(root)
    except OSError as error:
        raise FileError(
            "the change is committed, and not all files are in place:"
            f" {(error.strerror or str(error)).lower()}",
            where=root.path,
            hint="do not repeat it: when that is repaired, the next command that changes the"
            f" keystore completes it, or `pqsec -k {quote(root.path)} ca recover`",
        ) from error


def _rename(root: Folder, old: str, new: str) -> None:
    os.rename(old, new, src_dir_fd=root.handle, dst_dir_fd=root.handle)
    os.fsync(root.handle)


def _commit(transaction: Transaction, name: str) -> None:
    transaction.refuse_full_ledger()
    if transaction.entries and not transaction.begins_ledger:
        refuse_older_files(transaction)
    transaction.sign_head()
    transaction.refuse_folders()
    transaction.add_to_database()
    _moves.write(transaction)
    sync_filesystem(transaction.made.handle)
    if transaction.database and transaction.committed_by:
        _rename(transaction.root, name, PREPARED)
        if not _is_committed(transaction.root, transaction.database):
            return
        name = PREPARED
    _rename(transaction.root, name, JOURNAL)


def _is_committed(root: Folder, database: "PostgresLedger") -> bool:
    """Commit the lines in the database; False if that is done, and the change finished.

    KeystoreError if they are not committed, InterruptedChangeError if that is not known.
    """
    try:
        database.commit()
    except KeystoreError:
        database.close()
        if not _settle(root):
            raise
        return False
    return True


def _sweep(root: Folder) -> None:
    for name in root.names:
        if not name.startswith(DRAFT):
            continue
        if root.kind(name) == stat.S_IFDIR:
            _remove_tree(root, name)
        else:
            os.unlink(name, dir_fd=root.handle)
    _drafts.sweep(root.handle)
    for name in set_names(Path(root.path)):
        with suppress(FileNotFoundError), root.below(in_set(name, PRIVATE)) as private:
            _drafts.sweep(private.handle, SEEN)


def _remove_tree(root: Folder, name: str) -> None:
    """Remove a folder with a killed command's files, to which a fork of it may still add some."""
    for _ in range(_LAST_FILES):
        try:
            shutil.rmtree(name, dir_fd=root.handle)
        except OSError as error:
            if error.errno != errno.ENOTEMPTY:
                raise
        else:
            return
    shutil.rmtree(name, dir_fd=root.handle)


@contextmanager
def _disk_errors(root: Path) -> Iterator[None]:
    """Like `disk_errors`; names the keystore if the error has a descriptor or relative name."""
    with disk_errors(root):
        try:
            yield
        except OSError as error:
            for attribute in ("filename", "filename2"):
                path = getattr(error, attribute)
                is_path = isinstance(path, str | bytes)
                if not (is_path and os.fsdecode(path).startswith(("/", f"{root}"))):
                    setattr(error, attribute, None)
            raise
