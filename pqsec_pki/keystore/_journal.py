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
import fcntl
import json
import os
import pwd
import secrets
import shutil
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass, field, replace
from functools import cache
from pathlib import Path

from pqsec_pki._files import PRIVATE_MODE, PUBLIC_MODE, create, sync_filesystem, sync_folder
from pqsec_pki.errors import FileError, KeystoreError
from pqsec_pki.keystore import _layout, _shredding
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger

JOURNAL = ".journal"
DRAFT = ".draft-"
_MOVES = "moves.json"
PATIENCE = 30.0
"""Seconds to wait for another command to finish with the keystore."""


@dataclass(frozen=True, slots=True)
class DraftedFolder:
    """Files that will stand in one folder of the keystore."""

    path: str

    def public(self, name: str, data: bytes) -> None:
        """A file anyone may read."""
        create(f"{self.path}/{name}", data, mode=PUBLIC_MODE)

    def private(self, name: str, data: bytes) -> None:
        """A file for its owner only."""
        create(f"{self.path}/{name}", data, mode=PRIVATE_MODE)

    def link(self, name: str, target: str) -> None:
        """A symbolic link, relative to where it will stand."""
        os.symlink(target, f"{self.path}/{name}")


@dataclass(slots=True)
class Draft:
    """A change in the making. Folders are added by one thread; each may be filled by any."""

    root: Path
    path: Path
    targets: list[str] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)
    """Where, and what it will show, relative to its folder."""
    removed: list[str] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)

    def folder(self, target: str, *, private: bool) -> DraftedFolder:
        """An empty folder that will stand at, or be merged into, `target`."""
        _refuse_detours(self.root, [target])
        path = f"{self.path}/{len(self.targets)}"
        os.mkdir(path)
        os.chmod(path, 0o700 if private else 0o755)
        self.targets.append(target)
        return DraftedFolder(path)

    def link(self, place: str, target: str) -> None:
        """A symbolic link at `place`, in a folder that is there; another link is replaced.

        KeystoreError if a file or folder is there.
        """
        _refuse_detours(self.root, [os.path.dirname(place)])
        with suppress(FileNotFoundError):
            if not stat.S_ISLNK(os.lstat(f"{self.root}/{place}").st_mode):
                raise KeystoreError(
                    f"{self.root}/{place} should be a link, and is not", hint="move it away"
                )
        self.links.append((place, target))

    def remove(self, place: str) -> None:
        """The file or link at `place`, if there is one, goes when the change is done.

        KeystoreError if that is a folder.
        """
        _refuse_detours(self.root, [os.path.dirname(place)])
        with suppress(FileNotFoundError):
            if stat.S_ISDIR(os.lstat(f"{self.root}/{place}").st_mode):
                raise KeystoreError(f"{self.root}/{place} should be a file, and is a folder")
        self.removed.append(place)

    def shred(self, place: str) -> None:
        """What the file at `place` held is overwritten, once the change has replaced it."""
        _shredding.hold(self.path, f"{self.root}/{place}")

    def record(self, *entries: Entry) -> None:
        """Lines for the ledger, written when the change is.

        KeystoreError if that will not be possible.
        """
        if not self.entries:
            _check_ledger(self.root)
        operator = _operator()
        self.entries += [replace(entry, operator=operator) for entry in entries]


@contextmanager
def change(root: Path) -> Iterator[Draft]:
    """Draft a change to the keystore at `root`; committed when the block ends well.

    Only one process changes a keystore at a time. KeystoreError if another holds it for
    half a minute, FileError if the disk refuses.
    """
    with disk_errors(root):
        root.mkdir(mode=0o755, parents=True, exist_ok=True)
        with _locked(root):
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


def recover(root: Path) -> None:
    """Finish a change that was committed but not completed, if there is one."""
    with disk_errors(root):
        unfinished = (root / JOURNAL).exists()
    if unfinished:
        with change(root):
            pass


@contextmanager
def disk_errors(root: Path) -> Iterator[None]:
    """Say what the disk refuses as a FileError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise FileError(f"{error.filename or root}: {reason.lower()}") from error


@cache
def _operator() -> str:
    """Who runs this, as the system calls them."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"uid {os.getuid()}"


def _commit(draft: Draft) -> None:
    moves = {
        "targets": draft.targets,
        "links": draft.links,
        "removed": draft.removed,
        "entries": [astuple(entry) for entry in draft.entries],
    }
    create(draft.path / _MOVES, json.dumps(moves).encode(), mode=PRIVATE_MODE)
    sync_filesystem(draft.path)
    draft.path.rename(draft.root / JOURNAL)
    sync_folder(draft.root)


def _check_ledger(root: Path) -> None:
    """Before the point of no return: the ledger can be written, and is where it should be."""
    path = root / _layout.PRIVATE / _layout.LEDGER
    _refuse_detours(root, [_layout.PRIVATE])
    if path.is_symlink():
        raise KeystoreError(f"{path} should be a file, and is not")
    if path.parent.exists():
        with Ledger(path) as ledger:
            ledger.check()


def _finish(root: Path) -> None:
    """Do what the journal says; each step may have been done before."""
    journal = root / JOURNAL
    if not journal.is_dir():
        return
    targets, links, removed, entries = _read_moves(journal / _MOVES)
    others = (*(place for place, _ in links), *removed)
    _refuse_detours(root, (*targets, *map(os.path.dirname, others)))
    for parent in {os.path.dirname(f"{root}/{target}") for target in targets}:
        _make_folders(Path(parent))
    for number, target in enumerate(targets):
        _move(f"{journal}/{number}", f"{root}/{target}")
    for place, target in links:
        _link(journal, f"{root}/{place}", target)
    for place in removed:
        Path(root, place).unlink(missing_ok=True)
    if entries:
        with Ledger(root / _layout.PRIVATE / _layout.LEDGER) as ledger:
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


def _refuse_detours(root: Path, targets: Iterable[str]) -> None:
    """Nothing is written through a link, or where a file stands."""
    places = set(targets)
    for target in targets:
        above = target
        while (above := os.path.dirname(above)) and above not in places:
            places.add(above)
    for place in sorted(places):
        with suppress(FileNotFoundError):
            if not stat.S_ISDIR(os.lstat(f"{root}/{place}").st_mode):
                raise KeystoreError(f"{root}/{place} should be a folder, and is not")


@contextmanager
def _locked(root: Path) -> Iterator[None]:
    handle = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _lock(handle, root)
        yield
    finally:
        os.close(handle)


def _lock(handle: int, root: Path) -> None:
    give_up = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > give_up:
                raise KeystoreError(f"{root}: another pqsec command is at work here") from None
            time.sleep(0.05)
        else:
            return
