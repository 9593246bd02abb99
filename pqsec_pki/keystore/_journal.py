"""Changes to a keystore that happen wholly or not at all.

A change is drafted in a folder of its own inside the keystore: every byte is made, and
made durable, before anything else happens. Renaming that folder to `.journal` is the
commitment. Then the drafted folders are moved into place and the ledger is written.
Killed before the commitment, the draft is swept away; killed after it, the next command
that changes the keystore finishes the moves (`_moves.py`). A new participant's folder moves
in one rename. Who only reads changes nothing, and refuses a keystore that is half moved.

Links into folders that are there already are only written down, and made when the moves
are: ten thousand enclaves need not be drafted to give each a link.
"""

import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pqsec_pki._files import disk_errors, sync_filesystem
from pqsec_pki.errors import InterruptedChangeError
from pqsec_pki.keystore import _moves
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._lock import at_rest, locked
from pqsec_pki.keystore._moves import DRAFT, JOURNAL
from pqsec_pki.keystore._transaction import Transaction


@contextmanager
def change(root: Path) -> Iterator[Transaction]:
    """Stage a change to the keystore at `root`; committed when the block ends well.

    Only one process changes a keystore at a time. KeystoreError if another holds it for
    half a minute, or it is another user's, or others may write there; FileError if the disk
    refuses.
    """
    with _disk_errors(root):
        root.mkdir(mode=0o755, parents=True, exist_ok=True)
        with locked(root) as folder:
            _moves.finish(folder)
            _sweep(folder)
            name = f"{DRAFT}{secrets.token_hex(8)}"
            try:
                os.mkdir(name, 0o700, dir_fd=folder.handle)
                with folder.below(name) as made:
                    transaction = Transaction(folder, made)
                    yield transaction
                    _commit(transaction, name)
            except BaseException:
                shutil.rmtree(name, ignore_errors=True, dir_fd=folder.handle)
                raise
            _moves.finish(folder)


@contextmanager
def hold(root: Path) -> Iterator[None]:
    """Nobody else changes the keystore at `root` meanwhile, and no change is unfinished.

    The thread that holds it may change it as often as it likes. Errors as with `change`.
    """
    with _disk_errors(root), locked(root) as folder:
        _moves.finish(folder)
        yield


def recover(root: Path) -> bool:
    """Finish a change that was committed but not completed; whether there was one.

    Errors as with `change`.
    """
    journal = root / JOURNAL
    with disk_errors(journal):
        try:
            journal.lstat()
        except FileNotFoundError:
            return False
    with hold(root):
        return True


def check(root: Path) -> None:
    """KeystoreError if the keystore is another user's, or others may write there."""
    with disk_errors(root), Folder.opened(root) as folder:
        folder.refuse_outsiders()


def refuse_interrupted(root: Path) -> None:
    """InterruptedChangeError if a change is half done; a command that is at it is waited for.

    Nothing is altered. FileError if the disk refuses.
    """
    journal = root / JOURNAL
    with disk_errors(journal), suppress(FileNotFoundError):
        journal.lstat()
        with at_rest(root) as folder:
            if folder.kind(JOURNAL) is not None:
                raise InterruptedChangeError(
                    f"{root}: a change was interrupted when it was half done",
                    hint=f"`pqsec -k {root} ca recover` finishes it",
                )


def _commit(transaction: Transaction, name: str) -> None:
    transaction.refuse_folders()
    _moves.write(transaction)
    sync_filesystem(transaction.made.handle)
    root = transaction.root.handle
    os.rename(name, JOURNAL, src_dir_fd=root, dst_dir_fd=root)
    os.fsync(root)


def _sweep(root: Folder) -> None:
    for name in root.names:
        if not name.startswith(DRAFT):
            continue
        if root.kind(name) == stat.S_IFDIR:
            shutil.rmtree(name, dir_fd=root.handle)
        else:
            os.unlink(name, dir_fd=root.handle)


@contextmanager
def _disk_errors(root: Path) -> Iterator[None]:
    """As `disk_errors`; of a handle, or a name that is relative to one, the keystore is told."""
    with disk_errors(root):
        try:
            yield
        except OSError as error:
            for name in ("filename", "filename2"):
                told = getattr(error, name)
                named = isinstance(told, str | bytes)
                if not (named and os.fsdecode(told).startswith(("/", f"{root}"))):
                    setattr(error, name, None)
            raise
