"""Finds every file below some paths and reads it once, even if several links lead to it."""

import errno
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import field
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.credentials import CERTIFICATE, ENCLAVES, KEY, PERMISSIONS, SIX
from pqsec_pki.errors import FileError, InterruptedChangeError, PqsecError
from pqsec_pki.keystore import SETTINGS, Keystore, layout
from pqsec_pki.lint.file import File, file_with

MAX_FILES = 100_000
"""A keystore of 10,000 participants has 40,000 files; the limit stops at a home folder."""
MAX_BYTES = 1 << 30
"""Bytes of all files together, which stay in memory: that keystore has 0.2 GB."""
LEDGER = f"{layout.PRIVATE}/{layout.LEDGER}"

# In a folder, only files with such a name are read, including backup copies (key.pem~).
_RELEVANT = re.compile(
    r"\.(pem|crt|cer|der|key|crl|p7s|p7m|smime|xml|proof)(?![A-Za-z0-9])", re.IGNORECASE
)
_DRAFT = re.compile(r"\.(draft|pqsec)-[0-9a-f]{16}")
_UNFINISHED = (layout.JOURNAL, layout.PREPARED)
_OF_KEYSTORE = (SETTINGS, *(f"{each}/{layout.MOVES}" for each in _UNFINISHED))
"""A folder with one of these files is a keystore, or one that a killed command began."""
_TWO_OF_SIX = 2
_NO_TARGET = {errno.ENOENT, errno.ENOTDIR, errno.ELOOP}
"""Errors of a broken link. After other errors it is unknown whether the target exists."""


@dataclass(slots=True)
class Search:
    """The files found so far, by device and inode: a link is not a second file."""

    now: datetime
    proofs: bool = False
    """Whether each enclave must have a proof that the ledger has its documents."""
    files: dict[tuple[int, int], File] = field(default_factory=dict)
    folders: dict[Path, int] = field(default_factory=dict)
    enclaves: dict[Path, dict[str, tuple[int, int] | None]] = field(default_factory=dict)
    """Folder -> its files by name; None for a broken link."""
    named: set[Path] = field(default_factory=set)
    size: int = 0
    """Bytes read."""
    keystore: Keystore | None = None
    interrupted_change: Path | None = None
    missing_parts: dict[Path, tuple[str, ...]] = field(default_factory=dict)
    """For each keystore of pqsec that was named, the files that it lacks."""

    def add(self, path: Path) -> None:
        """Add a file, or a folder with everything in it."""
        try:
            found = path.stat()
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else None
            raise FileError((reason or str(error)).lower(), where=path) from error
        self.named.add(path)
        if not stat.S_ISDIR(found.st_mode):
            if not stat.S_ISREG(found.st_mode):
                raise FileError("not a file", where=path)
            self._file(path, found)
            return
        if self.keystore is None and any(os.path.isfile(path / each) for each in _OF_KEYSTORE):  # noqa: PTH113 -- no error
            self._settings(path)
        if missing := _missing_parts(path):
            self.missing_parts[path] = missing
        links = [link for folder, names in self._walk(path) for link in self._here(folder, names)]
        for link in links:  # after all files, so that these get their own paths
            self._link(*link)

    def _settings(self, root: Path) -> None:
        """Read the settings of a keystore; if a change was interrupted, only record that."""
        path = root / SETTINGS
        try:
            self.keystore = Keystore.open(root).as_found
        except InterruptedChangeError:
            there = [each for each in _UNFINISHED if os.path.lexists(root / each)]
            self.interrupted_change = root / (there or _UNFINISHED)[0]
        except PqsecError as error:
            self._unread(path, error.words_at(path))

    def _unread(self, path: Path, reason: str) -> None:
        """Record that a path exists but cannot be read, for PQS001.

        If its folder cannot be opened, the folder is recorded instead. FileError if the user
        named the path.
        """
        if path in self.named:
            raise FileError(reason, where=path)
        try:
            found = path.stat()
        except PermissionError:
            self._unread(path.parent, reason)
        except OSError:
            pass  # removed in the meantime
        else:
            key = (found.st_dev, found.st_ino)
            self.files[key] = File(path, b"", found.st_mode, self.now, reason)

    def _unlisted(self, error: OSError) -> None:
        self._unread(Path(error.filename), (error.strerror or str(error)).lower())

    def _walk(self, root: Path) -> Iterator[tuple[Path, list[str]]]:
        for folder, folders, names in os.walk(root, onerror=self._unlisted):
            path = Path(folder)
            folders[:] = sorted(name for name in folders if not _is_past(path, name))
            for name in folders if ENCLAVES in path.parts else ():
                if os.path.islink(f"{folder}/{name}"):  # noqa: PTH114 -- no error where it is closed
                    self._unread(path / name, "a link to a folder, which is not followed")
            with suppress(OSError):  # removed in the meantime
                self.folders[path] = path.stat().st_mode
            yield path, sorted(names)

    def _here(self, folder: Path, names: list[str]) -> Iterator[tuple[Path, str]]:
        """Add the files of a folder; return its links, each with the folder."""
        ours = dict(self._looked_at(folder, names))
        links = {name for name, found in ours.items() if stat.S_ISLNK(found.st_mode)}
        if _is_enclave(folder, ours):
            self.enclaves[folder] = {
                name: (found.st_dev, found.st_ino)
                for name, found in ours.items()
                if name not in links
            }
        for name, found in ours.items():
            if name not in links and stat.S_ISREG(found.st_mode):
                self._file(folder / name, found)
        return ((folder, name) for name in sorted(links))

    def _looked_at(self, folder: Path, names: list[str]) -> Iterator[tuple[str, os.stat_result]]:
        place = str(folder)
        for name in filter(_RELEVANT.search, names):
            try:
                yield name, os.lstat(f"{place}/{name}")
            except OSError as error:
                self._unlisted(error)

    def _link(self, folder: Path, name: str) -> None:
        """Add the link's target; if that cannot be accessed, the link is unreadable."""
        key = None
        try:
            found = os.stat(f"{folder}/{name}")  # noqa: PTH116 -- faster, for thousands of links
        except OSError as error:
            if error.errno not in _NO_TARGET:
                key = self._closed(folder / name, (error.strerror or str(error)).lower())
        else:
            if stat.S_ISREG(found.st_mode):
                key = (found.st_dev, found.st_ino)
                if key not in self.files:  # as the target of another link
                    self._file(folder / name, found)
        if folder in self.enclaves:
            self.enclaves[folder][name] = key

    def _closed(self, link: Path, reason: str) -> tuple[int, int] | None:
        try:
            found = link.lstat()
        except OSError:  # removed in the meantime
            return None
        key = (found.st_dev, found.st_ino)
        self._keep(key, File(link, b"", 0, self.now, reason))  # a link's own mode says nothing
        return key

    def _file(self, path: Path, found: os.stat_result) -> None:
        key = (found.st_dev, found.st_ino)
        if key in self.files:
            return
        try:
            data = read(path)
        except PqsecError as error:
            if path in self.named:
                raise
            self._keep(key, File(path, b"", found.st_mode, self.now, error.words_at(path)))
            return
        self.size += len(data)
        if self.size > MAX_BYTES:
            raise FileError(f"more than {MAX_BYTES} bytes to check", hint="name a smaller folder")
        self._keep(key, file_with(data, path, found.st_mode, self.now))

    def _keep(self, key: tuple[int, int], file: File) -> None:
        if len(self.files) >= MAX_FILES:
            raise FileError(f"more than {MAX_FILES} files to check", hint="name a smaller folder")
        self.files[key] = file


def _missing_parts(root: Path) -> tuple[str, ...]:
    """The missing files of a keystore of pqsec; none for other folders.

    A keystore of pqsec has settings or a ledger: a keystore of SROS2 and a robot's copy have
    neither. Files in a folder that cannot be opened do not count as missing.
    """
    names = (SETTINGS, layout.PRIVATE, LEDGER)
    missing = tuple(each for each in names if _is_missing(root / each))
    if missing == (LEDGER,) and _has_database(root):
        return ()
    if _is_missing(root / "public") or _is_missing(root / ENCLAVES):
        return ()
    return () if {SETTINGS, LEDGER} <= {*missing} else missing


def _has_database(root: Path) -> bool:
    """Whether the ledger of the keystore at `root` is in a database."""
    with suppress(PqsecError):
        return Keystore.open(root).ledger_address is not None
    return False


def _is_missing(path: Path) -> bool:
    try:
        path.lstat()
    except OSError as error:
        return error.errno in _NO_TARGET
    return False


def _is_past(parent: Path, name: str) -> bool:
    """Whether the folder there holds replaced CAs, or a draft of a command that was killed.

    Replaced CAs are no longer trusted; the next command that writes removes the draft.
    """
    is_of_cas = name == "generations" and parent.name == "private"
    return is_of_cas or _DRAFT.fullmatch(name) is not None


def _is_enclave(folder: Path, names: Iterable[str]) -> bool:
    """Whether a folder has a participant's files: below enclaves/ one of them, else two."""
    here = set(names)
    if ENCLAVES in folder.parts:
        return bool(here & {CERTIFICATE, KEY, PERMISSIONS})
    return len(here & set(SIX)) >= _TWO_OF_SIX and bool(here & {CERTIFICATE, PERMISSIONS})
