"""A change to a keystore in the making: files in folders of its own, and what shall be done.

Whatever could stand in the way later is refused here, while nothing has been touched.
"""

import os
import stat
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace

from pqsec_pki._files import PRIVATE_MODE, PUBLIC_MODE, create
from pqsec_pki._owners import user
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _layout, _ledger, _shredding
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._folder import Folder, should_be


@dataclass(frozen=True, slots=True)
class StagedFolder:
    """Files that will stand in one folder of the keystore. Forks of this process may fill it."""

    transaction: int
    """The handle of the draft's folder, where nobody else may write."""
    name: str

    def public(self, name: str, data: bytes) -> None:
        """A file anyone may read."""
        create(f"{self.name}/{name}", data, mode=PUBLIC_MODE, folder=self.transaction)

    def private(self, name: str, data: bytes) -> None:
        """A file for its owner only."""
        create(f"{self.name}/{name}", data, mode=PRIVATE_MODE, folder=self.transaction)

    def link(self, name: str, target: str) -> None:
        """A symbolic link, relative to where it will stand."""
        os.symlink(target, f"{self.name}/{name}", dir_fd=self.transaction)

    def set_mode(self, mode: int) -> None:
        """The folder's permission bits, from the beginning on."""
        os.chmod(self.name, mode, dir_fd=self.transaction)

    @property
    def names(self) -> list[str]:
        """What is in it so far, sorted."""
        handle = os.open(self.name, os.O_RDONLY | os.O_DIRECTORY, dir_fd=self.transaction)
        try:
            return sorted(os.listdir(handle))
        finally:
            os.close(handle)


@dataclass(slots=True)
class Transaction:
    """A change in the making. Folders are added by one thread; each may be filled by any."""

    root: Folder
    """The keystore's."""
    made: Folder
    """Its own, in there."""
    targets: list[str] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)
    """Where, and what it will show, relative to its folder."""
    removed: list[str] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    begins_ledger: bool = False
    """Whether the ledger may be missing when the lines are written."""

    def folder(self, target: str, *, private: bool) -> StagedFolder:
        """An empty folder that will stand at, or be merged into, `target`."""
        refuse_detours(self.root, [target])
        name = str(len(self.targets))
        os.mkdir(name, dir_fd=self.made.handle)
        staged = StagedFolder(self.made.handle, name)
        staged.set_mode(0o700 if private else 0o755)
        self.targets.append(target)
        return staged

    def link(self, place: str, target: str) -> None:
        """A symbolic link at `place`, in a folder that is there; another link is replaced.

        KeystoreError if a file or folder is there.
        """
        refuse_detours(self.root, [os.path.dirname(place)])
        if self.root.kind(place) not in {None, stat.S_IFLNK}:
            raise should_be(f"{self.root.path}/{place}", "link")
        self.links.append((place, target))

    def remove(self, place: str) -> None:
        """The file or link at `place`, if there is one, goes when the change is done.

        KeystoreError if that is a folder.
        """
        refuse_detours(self.root, [os.path.dirname(place)])
        if self.root.kind(place) == stat.S_IFDIR:
            raise KeystoreError(f"{self.root.path}/{place} should be a file, and is a folder")
        self.removed.append(place)

    def shred(self, place: str) -> None:
        """What the file at `place` held is overwritten, once the change has replaced it."""
        folder, _, name = place.rpartition("/")
        with suppress(FileNotFoundError), self.root.below(folder) as there:
            _shredding.hold(self.made, there, name)

    def record(self, *entries: Entry) -> None:
        """Lines for the ledger, written when the change is.

        KeystoreError if that will not be possible.
        """
        if not self.entries:
            # A keystore has a ledger; CAs of others, which are being adopted, do not.
            self.begins_ledger = self.root.kind(_layout.SETTINGS) is None
            _check_ledger(self.root, begin=self.begins_ledger)
        operator = user(os.getuid())
        self.entries += [replace(entry, operator=operator) for entry in entries]

    def refuse_folders(self) -> None:
        """KeystoreError if a drafted file would have to replace a folder."""
        for number, target in enumerate(self.targets):
            with suppress(FileNotFoundError), self.root.below(target) as goal:
                with os.scandir(goal.handle) as found:
                    folders = {each.name for each in found if each.is_dir(follow_symlinks=False)}
                staged = StagedFolder(self.made.handle, str(number))
                taken = folders and folders.intersection(staged.names)
                if taken:
                    raise KeystoreError(
                        f"{goal.path}/{min(taken)} should be a file, and is a folder",
                        hint="move it away",
                    )


def _check_ledger(root: Folder, *, begin: bool) -> None:
    """Before the point of no return: the ledger can be written, and is where it should be."""
    with suppress(FileNotFoundError), root.below(_layout.PRIVATE) as private:
        _ledger.check(private, begin=begin)


def refuse_detours(root: Folder, targets: Iterable[str]) -> None:
    """KeystoreError if anything would be written through a link, or where a file stands.

    So that it is told before anything is done; who does it goes by handles.
    """
    places = set(targets)
    for target in targets:
        above = target
        while (above := os.path.dirname(above)) and above not in places:
            places.add(above)
    for place in sorted(places):
        if root.kind(place or ".") not in {None, stat.S_IFDIR}:
            raise should_be(f"{root.path}/{place}", "folder")
