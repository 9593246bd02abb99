"""A staged change to a keystore: files in its own folders, and the steps after the commit.

Anything that would make a later step fail is refused here, before the keystore is touched.
"""

import os
import stat
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import PRIVATE_MODE, PUBLIC_MODE, create
from pqsec_pki._owners import operator
from pqsec_pki.errors import ExistsError, KeystoreError, TooLargeError
from pqsec_pki.keystore import _file_store, _ledger_file, _moved_ledger, _shredding, layout
from pqsec_pki.keystore._chain import Entry, details_text
from pqsec_pki.keystore._file_store import FileStore
from pqsec_pki.keystore._folder import Folder, should_be
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._set_change import SetChange
from pqsec_pki.keystore._shared_files import LedgerFile, recorded_files
from pqsec_pki.keystore._store import MAX_DETAILS
from pqsec_pki.keystore.heads import extended, other_sets
from pqsec_pki.keystore.signing_clock import refuse_wrong_clock

if TYPE_CHECKING:
    from pqsec_pki.keystore._postgres import PostgresLedger
    from pqsec_pki.keystore.authorities import Authorities

_SMALLER = "change fewer participants at once"


@dataclass(frozen=True, slots=True)
class StagedFolder:
    """Files for one folder of the keystore. Forks of this process may fill it."""

    transaction: int
    """The descriptor of the transaction's folder, where only the owner may write."""
    name: str

    def public(self, name: str, data: bytes) -> None:
        """Stage a file that everyone may read."""
        create(f"{self.name}/{name}", data, mode=PUBLIC_MODE, folder=self.transaction)

    def private(self, name: str, data: bytes) -> None:
        """Stage a file for its owner only."""
        create(f"{self.name}/{name}", data, mode=PRIVATE_MODE, folder=self.transaction)

    def link(self, name: str, target: str) -> None:
        """Stage a symbolic link; `target` is relative to the final folder."""
        os.symlink(target, f"{self.name}/{name}", dir_fd=self.transaction)

    def set_mode(self, mode: int) -> None:
        """Set the folder's permission bits."""
        os.chmod(self.name, mode, dir_fd=self.transaction)

    @property
    def names(self) -> list[str]:
        """The names staged so far, sorted."""
        handle = os.open(self.name, os.O_RDONLY | os.O_DIRECTORY, dir_fd=self.transaction)
        try:
            return sorted(os.listdir(handle))
        finally:
            os.close(handle)


@dataclass(slots=True)
class Transaction:
    """A staged change. One thread adds folders; any thread or fork may fill each of them."""

    root: Folder
    """The keystore's folder."""
    made: Folder
    """The folder inside it where the change is staged."""
    targets: list[str] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)
    """Place of each link, and its target relative to its folder."""
    removed: list[str] = field(default_factory=list)
    emptied: list[str] = field(default_factory=list)
    """Folders that are removed if nothing is left in them, those inside others first."""
    entries: list[Entry] = field(default_factory=list)
    database: "PostgresLedger | None" = None
    """The ledger, if it is not in a file; no other machine adds lines meanwhile."""
    committed_by: tuple[int, str] | None = None
    """Number and chain value of the line whose commit in the database is that of the change."""
    begins_ledger: bool = False
    """Whether the ledger may be missing when the lines are written."""
    authorities: "Authorities | None" = None
    """The CAs that sign the ledger's next head, if their keys are at hand."""
    clock_was_checked: bool = False

    @property
    def number(self) -> int:
        """The sequence number of what this change signs: that of its first ledger line.

        Each change adds lines, so a later one signs with a larger number, whatever clocks say. In a
        ledger that `pqsec adopt` began again, it is also above the numbers of the lost one.
        """
        with self.opened_ledger() as ledger:
            return ledger.above + ledger.size + 1

    def refuse_lines(self) -> None:
        """ExistsError if the database has lines already: a keystore begins its own ledger."""
        if self.database:
            with Ledger(self.database) as ledger:
                if ledger.size:
                    raise ExistsError(
                        f"{self.database.place} has the ledger of a keystore already",
                        hint="name another database; to use that keystore on this machine, copy"
                        " it: docs/how-to/postgresql.md",
                    )

    def folder(self, target: str, *, private: bool) -> StagedFolder:
        """Stage an empty folder that will become, or be merged into, `target`."""
        refuse_detours(self.root, [target])
        _refuse_open(self.root, target, closes=private)
        name = str(len(self.targets))
        os.mkdir(name, dir_fd=self.made.handle)
        staged = StagedFolder(self.made.handle, name)
        staged.set_mode(0o700 if private else 0o755)
        self.targets.append(target)
        return staged

    def of(self, set_name: str) -> SetChange:
        """The part of this change that is about the set called `set_name`."""
        return SetChange(self, set_name)

    def link(self, place: str, target: str) -> None:
        """Record a symbolic link at `place`, in an existing folder; it replaces another link.

        KeystoreError if a file or folder is at `place`.
        """
        refuse_detours(self.root, [os.path.dirname(place)])
        if self.root.kind(place) not in {None, stat.S_IFLNK}:
            raise should_be(f"{self.root.path}/{place}", "link")
        self.links.append((place, target))

    def remove(self, place: str) -> None:
        """Record that the file or link at `place`, if there is one, will be removed.

        KeystoreError if a folder is at `place`.
        """
        refuse_detours(self.root, [os.path.dirname(place)])
        kind = self.root.kind(place)
        if kind == stat.S_IFDIR:
            raise KeystoreError(f"{self.root.path}/{place} should be a file, and is a folder")
        if kind is not None:
            self.removed.append(place)

    def remove_empty(self, folder: str) -> None:
        """Record that the folder will be removed, unless something is still in it.

        Its folders come before it.
        """
        refuse_detours(self.root, [folder])
        self.emptied.append(folder)

    def shred(self, place: str) -> None:
        """Overwrite the old content of the file at `place` after the change has replaced it."""
        folder, _, name = place.rpartition("/")
        with suppress(FileNotFoundError), self.root.below(folder) as there:
            _shredding.hold(self.made, there, name)

    def record(self, *entries: Entry) -> None:
        """Add entries for the ledger, written with the change.

        KeystoreError if the ledger cannot be written, or something is signed with a clock that
        cannot be right; TooLargeError for a line that could not be read again; UsageError as of
        `operator`.
        """
        if not (self.entries or self.database):
            # A keystore has a ledger; a keystore that is being adopted has none.
            self.begins_ledger = self.root.kind(layout.SETTINGS) is None
            _check_ledger(self.root, begin=self.begins_ledger)
        for entry in entries:
            size = len(details_text(entry))
            TooLargeError.check("a line of the ledger", size, MAX_DETAILS, hint=_SMALLER)
        self._refuse_wrong_clock(entries)
        name = operator()
        self.entries += [replace(entry, operator=name) for entry in entries]

    def refuse_full_ledger(self) -> None:
        """TooLargeError if the ledger's file could not be read with the new lines."""
        if self.database is None and self.entries:
            with self._ledger_folder() as folder:
                _file_store.refuse_full(folder, self.entries, begin=self.begins_ledger)

    def _refuse_wrong_clock(self, entries: Sequence[Entry]) -> None:
        """KeystoreError as of `refuse_wrong_clock`, by the time of the first lines of a change."""
        if self.authorities is None or self.clock_was_checked or not entries:
            return
        with self.opened_ledger() as ledger:
            refuse_wrong_clock(ledger, self.authorities, entries[0].made_at)
        self.clock_was_checked = True

    def sign_head(self) -> None:
        """Stage the head of the ledger with the new lines, if the signers' keys were opened."""
        if self.authorities is None or not self.authorities.can_sign:
            return
        path = Path(self.root.path)
        with self.opened_ledger() as ledger:
            signed = extended(path, ledger, self.entries, self.authorities)
        if signed:
            public = self.folder(layout.PUBLIC, private=False)
            for name, data in signed.files():
                public.public(name, data)

    def take_over(self, ledger: Ledger) -> bool:
        """Put the lines of `ledger` into the database; False if that has newer ones too.

        KeystoreError if these are about a set of credentials that is not here.
        """
        if self.database is None:
            raise ValueError("the ledger is not for a database")
        is_whole = _moved_ledger.take_over(self.database, ledger)
        with Ledger(self.database) as there:
            if wrong := other_sets(Path(self.root.path), there):
                raise wrong
        return is_whole

    def stage_ledger_file(self) -> None:
        """Stage the ledger, with the new lines, as a file, and read it back.

        KeystoreError if it has other lines then, TooLargeError if it could not be read.
        """
        with self.opened_ledger() as ledger:
            ledger.append(self.entries)
            wanted = ledger.stored()
            private = self.folder(layout.PRIVATE, private=True)
            data = ledger.to_file()
            _ledger_file.refuse_larger(len(data))
            private.private(layout.LEDGER, data)
        with self.made.below(private.name) as staged, Ledger(FileStore(staged)) as ledger:
            if ledger.stored() != wanted:
                raise KeystoreError(f"{staged.path}/{layout.LEDGER} has other lines than written")

    def add_to_database(self) -> None:
        """Add the lines to the database, if the ledger is there, without committing them."""
        if self.database is None:
            return
        with Ledger(self.database) as ledger:
            before = ledger.size
            ledger.append(self.entries)
            if ledger.size > before:
                self.committed_by = ledger.size, ledger.head
                self.database.add(ledger.stored(after=before))
                folders = [str(number) for number in range(len(self.targets))]
                self.database.keep(recorded_files(self.made, folders, self.entries))

    def kept(self, files: Collection[LedgerFile]) -> dict[LedgerFile, bytes]:
        """The content of those of these files that the database keeps."""
        if self.database is None:
            return {}
        contents = self.database.kept({each.sha256 for each in files})
        return {each: data for each in files if (data := each.in_(contents))}

    def stages(self, target: str, name: str) -> bool:
        """Whether a file of that name is staged for the folder `target`."""
        numbers = (number for number, each in enumerate(self.targets) if each == target)
        return any(name in StagedFolder(self.made.handle, f"{each}").names for each in numbers)

    @contextmanager
    def opened_ledger(self, set_name: str = layout.FIRST) -> Iterator[Ledger]:
        """The ledger as it is, for questions about that set; a new one for a keystore that is being
        created."""
        if self.database:
            with Ledger(self.database, set_name) as ledger:
                yield ledger
            return
        with (
            self._ledger_folder() as folder,
            Ledger(FileStore(folder, begin=self.begins_ledger), set_name) as ledger,
        ):
            yield ledger

    @contextmanager
    def _ledger_folder(self) -> Iterator[Folder]:
        """The folder with the ledger's file; that of the change in a new keystore."""
        there = self.root.kind(layout.PRIVATE) is not None
        with self.root.below(layout.PRIVATE) if there else nullcontext(self.made) as folder:
            yield folder

    def refuse_folders(self) -> None:
        """KeystoreError if a staged file would have to replace a folder."""
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
    """Check before the commit that the ledger is in place and can be written."""
    with suppress(FileNotFoundError), root.below(layout.PRIVATE) as private:
        _file_store.check(private, begin=begin)


def refuse_detours(root: Folder, targets: Iterable[str]) -> None:
    """KeystoreError if a target's folder is a link or a file.

    It reports this before the commit; the moves themselves use descriptors and follow no link.
    """
    for place in _with_folders_above(targets):
        if root.kind(place or ".") not in {None, stat.S_IFDIR}:
            raise should_be(f"{root.path}/{place}", "folder")


def _refuse_open(root: Folder, target: str, *, closes: bool) -> None:
    """KeystoreError if another user could change the target, or a folder above it.

    The target itself may be open if the change closes it, and replaces what is in it.
    """
    for place in _with_folders_above([target]):
        if not (closes and place == target):
            root.refuse_outsiders_of(place or ".")


def _with_folders_above(targets: Iterable[str]) -> list[str]:
    """The targets and the folders above them in the keystore, from the top."""
    places = set(targets)
    for above in tuple(places):
        while (above := os.path.dirname(above)) and above not in places:
            places.add(above)
    return sorted(places)
