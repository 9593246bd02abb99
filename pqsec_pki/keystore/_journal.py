"""Changes to a keystore that happen wholly or not at all.

A change is drafted in a folder of its own inside the keystore: every byte is made, and
made durable, before anything else happens. Renaming that folder to `.journal` is the
commitment. Then the drafted folders are moved into place and the ledger is written.
Killed before the commitment, the draft is swept away; killed after it, whoever opens
the keystore next finishes the moves. A new participant's folder moves in one rename.

Links into folders that are there already are only written down, and made when the moves
are: ten thousand enclaves need not be drafted to give each a link.
"""

import errno
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from operator import attrgetter
from pathlib import Path

from pqsec_pki._files import (
    PRIVATE_MODE,
    create,
    disk_errors,
    sync_filesystem,
    sync_folder,
)
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _layout, _shredding
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._draft import Draft, refuse_detours
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._lock import locked

JOURNAL = ".journal"
DRAFT = ".draft-"
_MOVES = "moves.json"
_VALUES = attrgetter(*(each.name for each in fields(Entry)))


@contextmanager
def change(root: Path) -> Iterator[Draft]:
    """Draft a change to the keystore at `root`; committed when the block ends well.

    Only one process changes a keystore at a time. KeystoreError if another holds it for
    half a minute, FileError if the disk refuses.
    """
    with disk_errors(root):
        root.mkdir(mode=0o755, parents=True, exist_ok=True)
        with locked(root):
            _finish(root)
            _sweep(root)
            draft = Draft(root, root / f"{DRAFT}{secrets.token_hex(8)}")
            try:
                draft.path.mkdir(mode=0o700)
                yield draft
                _commit(draft)
            except BaseException:
                shutil.rmtree(draft.path, ignore_errors=True)
                raise
            _finish(root)


@contextmanager
def hold(root: Path) -> Iterator[None]:
    """Nobody else changes the keystore at `root` meanwhile, and no change is unfinished.

    The thread that holds it may change it as often as it likes. Errors as with `change`.
    """
    with disk_errors(root), locked(root):
        _finish(root)
        yield


def recover(root: Path) -> None:
    """Finish a change that was committed but not completed, if there is one."""
    with disk_errors(root):
        unfinished = (root / JOURNAL).exists()
    if unfinished:
        with change(root):
            pass


def _commit(draft: Draft) -> None:
    draft.refuse_folders()
    moves = {
        "targets": draft.targets,
        "links": draft.links,
        "removed": draft.removed,
        "entries": [_VALUES(entry) for entry in draft.entries],
    }
    create(draft.path / _MOVES, json.dumps(moves).encode(), mode=PRIVATE_MODE)
    sync_filesystem(draft.path)
    draft.path.rename(draft.root / JOURNAL)
    sync_folder(draft.root)


def _finish(root: Path) -> None:
    """Do what the journal says; each step may have been done before."""
    journal = root / JOURNAL
    if not journal.is_dir():
        return
    targets, links, removed, entries = _read_moves(journal / _MOVES)
    others = (*(place for place, _ in links), *removed)
    refuse_detours(root, (*targets, *map(os.path.dirname, others)))
    for parent in {os.path.dirname(f"{root}/{target}") for target in targets}:
        _make_folders(Path(parent))
    for number, target in enumerate(targets):
        _move(f"{journal}/{number}", f"{root}/{target}")
    for place, target in links:
        _link(journal, f"{root}/{place}", target)
    for place in removed:
        Path(root, place).unlink(missing_ok=True)
    if entries:
        with Ledger(root / _layout.PRIVATE / _layout.LEDGER, begin=True) as ledger:
            ledger.add(entries)
    sync_filesystem(root)
    _shredding.shred(journal)
    spent = journal.rename(root / f"{DRAFT}{secrets.token_hex(8)}")
    shutil.rmtree(spent)


def _link(journal: Path, place: str, target: str) -> None:
    made = journal / "link"
    made.unlink(missing_ok=True)
    made.symlink_to(target)
    with suppress(FileNotFoundError):  # the folder was removed since, and needs no link
        made.replace(place)


_Moves = tuple[list[str], list[tuple[str, str]], list[str], list[Entry]]
"""Folders, links, what is removed, and the ledger's new lines."""


def _read_moves(path: Path) -> _Moves:
    try:
        moves = json.loads(path.read_bytes())
        targets = [str(target) for target in moves["targets"]]
        links = [(str(place), str(target)) for place, target in moves.get("links", [])]
        removed = [str(place) for place in moves.get("removed", [])]
        entries = [Entry(*entry) for entry in moves["entries"]]
        entries = [replace(entry, details=dict(entry.details)) for entry in entries]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise _unreadable(path) from None
    places = (*targets, *(place for place, _ in links), *removed)
    if any("\0" in each or each.startswith("/") or ".." in each.split("/") for each in places):
        raise _unreadable(path)
    return targets, links, removed, entries


def _unreadable(path: Path) -> KeystoreError:
    return KeystoreError(f"{path}: this unfinished change cannot be read")


def _move(drafted: str, goal: str) -> None:
    if not os.path.isdir(drafted):
        return
    try:
        os.rename(drafted, goal)  # where nothing is yet, or an empty folder
    except OSError as error:
        if error.errno not in {errno.ENOTEMPTY, errno.EEXIST, errno.EBUSY, errno.EINVAL}:
            raise
        _merge(drafted, goal)


def _merge(drafted: str, goal: str) -> None:
    # Never wider than it was: the user may have closed it.
    os.chmod(goal, os.stat(goal).st_mode & os.stat(drafted).st_mode & 0o777)
    # The certificate last: with it, a folder is a participant.
    for name in sorted(os.listdir(drafted), key=lambda name: (name == _layout.CERTIFICATE, name)):
        os.replace(f"{drafted}/{name}", f"{goal}/{name}")
    os.rmdir(drafted)


def _make_folders(path: Path) -> None:
    """`path` and the folders above; nobody else may write in them, whatever the umask."""
    for folder in (*reversed(path.parents), path):
        folder.mkdir(mode=0o755, exist_ok=True)


def _sweep(root: Path) -> None:
    for leftover in root.glob(f"{DRAFT}*"):
        if leftover.is_dir() and not leftover.is_symlink():
            shutil.rmtree(leftover)
        else:
            leftover.unlink()
