"""A change to a keystore in the making: files in folders of its own, and what shall be done.

Whatever could stand in the way later is refused here, while nothing has been touched.
"""

import os
import pwd
import stat
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from pqsec_pki._files import PRIVATE_MODE, PUBLIC_MODE, create
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _layout, _shredding
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger


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
        refuse_detours(self.root, [target])
        path = f"{self.path}/{len(self.targets)}"
        os.mkdir(path)
        os.chmod(path, 0o700 if private else 0o755)
        self.targets.append(target)
        return DraftedFolder(path)

    def link(self, place: str, target: str) -> None:
        """A symbolic link at `place`, in a folder that is there; another link is replaced.

        KeystoreError if a file or folder is there.
        """
        refuse_detours(self.root, [os.path.dirname(place)])
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
        refuse_detours(self.root, [os.path.dirname(place)])
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

    def refuse_folders(self) -> None:
        """KeystoreError if a drafted file would have to replace a folder."""
        for number, target in enumerate(self.targets):
            drafted, goal = f"{self.path}/{number}", f"{self.root}/{target}"
            with suppress(FileNotFoundError), os.scandir(goal) as found:
                folders = {each.name for each in found if each.is_dir(follow_symlinks=False)}
                taken = folders and folders.intersection(os.listdir(drafted))
                if taken:
                    raise KeystoreError(
                        f"{goal}/{min(taken)} should be a file, and is a folder",
                        hint="move it away",
                    )


@cache
def _operator() -> str:
    """Who runs this, as the system calls them."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"uid {os.getuid()}"


def _check_ledger(root: Path) -> None:
    """Before the point of no return: the ledger can be written, and is where it should be."""
    path = root / _layout.PRIVATE / _layout.LEDGER
    refuse_detours(root, [_layout.PRIVATE])
    if path.is_symlink():
        raise KeystoreError(f"{path} should be a file, and is not")
    if path.parent.exists():
        # A keystore has one; CAs of others, which are being adopted, do not.
        with Ledger(path, begin=not (root / _layout.SETTINGS).exists()) as ledger:
            ledger.check()


def refuse_detours(root: Path, targets: Iterable[str]) -> None:
    """KeystoreError if anything would be written through a link, or where a file stands."""
    places = set(targets)
    for target in targets:
        above = target
        while (above := os.path.dirname(above)) and above not in places:
            places.add(above)
    for place in sorted(places):
        with suppress(FileNotFoundError):
            if not stat.S_ISDIR(os.lstat(f"{root}/{place}").st_mode):
                raise KeystoreError(f"{root}/{place} should be a folder, and is not")
