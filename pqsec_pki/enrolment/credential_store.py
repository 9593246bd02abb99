"""The credential store of a robot: its installations, and which one is current.

current -> installed/3  what processes read; one rename changes all files at once
installed/<n>/          enclaves/<path>/..., sets/<profile>/enclaves/<path>/... of each further set
                        of credentials, and installed.json: which sets, and what was before
installed.receipt       what is current, signed (receipt.py)
requests/<name>/        key.pem [alt.key.pem] request.csr, until the answer is installed
trust.json              the trusted CAs, the newest documents that were ever installed, and the
                        count of receipts
bundle.key.pem          the key that opens sealed bundles, if it was created

An installation never changes after it was created. The one before the current one is kept.
"""

import json
import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import field
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import (
    PRIVATE_MODE,
    PUBLIC_MODE,
    create,
    disk_errors,
    read,
    refuse_without_links,
    sync_filesystem,
    sync_folder,
    walk,
)
from pqsec_pki._places import refuse_outsiders
from pqsec_pki.credentials import CERTIFICATE, ENCLAVES, FILES, KEY, KEYS, PROOF
from pqsec_pki.enrolment._own_folder import DRAFT, locked, make_private, sweep
from pqsec_pki.enrolment._written_again import Enclaves
from pqsec_pki.enrolment.bundle import flat_name, name_of
from pqsec_pki.enrolment.pins import set_named
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.errors import KeystoreError, MalformedError, located, other_format
from pqsec_pki.keystore import bundle_number, layout

CURRENT, INSTALLED, REQUESTS = "current", "installed", "requests"
RECORD = "installed.json"
RECEIPT = "installed.receipt"
TRUST = "trust.json"
_OWN = (INSTALLED, REQUESTS, CURRENT, TRUST, "bundle.key.pem", "server.json")
"""The store's own files: the folder may contain files of others."""
FORMAT = 2
_NUMBER = re.compile("[1-9][0-9]{0,8}")


def is_credential_store(root: Path) -> bool:
    """Whether credentials were installed there, or keys generated."""
    installed = os.path.lexists(root / CURRENT) and (root / INSTALLED).is_dir()
    return installed or any((root / REQUESTS).glob(f"*/{KEY}"))


@dataclass(frozen=True, slots=True)
class InstalledCredentials:
    """What one installation put into the store."""

    path: Path
    at: datetime
    """The time of installation."""
    previous: str | None
    """The number of the installation that it replaced."""
    numbers: Mapping[str, int] = field(default_factory=dict)
    """The number of the bundle from which each participant came, where it had one."""
    further: tuple[str, ...] = ()
    """The further sets of credentials that were installed."""

    @property
    def enclaves(self) -> Enclaves:
        """The files of the first set; FileError if they cannot be read."""
        return self._enclaves(layout.FIRST)

    @property
    def sets(self) -> dict[str, Enclaves]:
        """The files of each set that was installed, the first one first; errors likewise."""
        return {each: self._enclaves(each) for each in (layout.FIRST, *self.further)}

    def _enclaves(self, place: str) -> Enclaves:
        root = self.path / layout.in_set(place, ENCLAVES)
        there = walk(root) if root.is_dir() else ()
        folders = sorted(folder for folder, names in there if CERTIFICATE in names)
        return {f"/{each.relative_to(root).as_posix()}": _files_in(each) for each in folders}


@dataclass(frozen=True, slots=True)
class CredentialStore:
    """The credential store in the folder `root`."""

    root: Path

    @property
    def current(self) -> InstalledCredentials | None:
        """The current installation, if there is one; KeystoreError if it is damaged."""
        link = self.root / CURRENT
        if not os.path.lexists(link):
            return None
        folder, _, name = str(link.readlink() if link.is_symlink() else "").partition("/")
        if folder != INSTALLED or not _NUMBER.fullmatch(name):
            raise KeystoreError(
                f"{link} is not a link created by pqsec", hint="install into another --dir"
            )
        return self.installation_numbered(name)

    @property
    def trust_state(self) -> TrustState | None:
        """The saved trust state, if any; KeystoreError if it is damaged."""
        path = self.root / TRUST
        if not os.path.lexists(path):
            return None
        with located(path):
            return TrustState.from_json(read(path))

    def trust(self, state: TrustState) -> None:
        """Save the trust state atomically."""
        data, path = state.to_json(), self.root / TRUST
        if os.path.lexists(path) and read(path) == data:
            return
        self._drafted(data, PRIVATE_MODE).rename(path)
        sync_folder(self.root)

    def refuse_without_links(self) -> None:
        """FileError if the file system has no symbolic links, and nothing is installed yet."""
        if not os.path.lexists(self.root / CURRENT):
            refuse_without_links(self.root, "a robot's folder")

    def installation_numbered(self, name: str) -> InstalledCredentials:
        """That installation; KeystoreError if it is damaged, FileError if it does not exist."""
        path = self.root / INSTALLED / name
        try:
            record = json.loads(read(path / RECORD))
            if record["format"] != FORMAT:
                raise other_format(KeystoreError, record["format"], (FORMAT,), where=path)
            at, previous = datetime.fromisoformat(record["at"]), _previous(record["previous"])
            numbers = {
                name: number
                for name, value in record.get("bundles", {}).items()
                if (number := bundle_number(value))
            }
            further = tuple(map(set_named, record["sets"]))
            return InstalledCredentials(path, at, previous, numbers, further)
        except (
            *(ValueError, KeyError, TypeError, AttributeError, RecursionError),
            MalformedError,
        ) as error:
            raise KeystoreError(f"{path / RECORD} cannot be read: {error}") from error

    def keys(self, name: str, place: str = layout.FIRST) -> Iterator[Mapping[str, bytes]]:
        """Files with keys for `name` in a set that were created or installed here: of requests,
        then of installations.

        Empty if there are none.
        """
        yield _files_in(self.request_folder(name) / layout.in_set(place, ""))
        enclave = layout.in_set(place, layout.enclave_folder(name))
        for each in sorted(self._numbers(), reverse=True):
            yield _files_in(self.root / INSTALLED / str(each) / enclave)

    @property
    def names(self) -> list[str]:
        """The participants for which there is a request or current credentials, sorted."""
        folder = self.root / REQUESTS
        asked = [name_of(each.name) for each in folder.iterdir()] if folder.is_dir() else []
        return sorted({*asked, *(self.current.enclaves if self.current else ())})

    def request_folder(self, name: str) -> Path:
        """The folder with the keys for `name` until their certificate is installed."""
        return self.root / REQUESTS / flat_name(name)

    def put(
        self,
        sets: Mapping[str, Enclaves],
        state: TrustState,
        now: datetime,
        *,
        numbers: Mapping[str, int],
        receipt: bytes,
    ) -> None:
        """Create an installation of these files and make it current, completely or not at all.

        The trust state is saved when it is complete and before it becomes current. If the
        process is killed between the two, the marks are not older than what is installed.
        """
        before = self.current
        record = {
            "format": FORMAT,
            "at": now.isoformat(timespec="seconds"),
            "previous": before.path.name if before else None,
            "bundles": numbers,
            "sets": [each for each in sets if each != layout.FIRST],
        }
        draft = self._draft(sets, record)
        self.trust(state)
        name = str(max(self._numbers(), default=0) + 1)
        draft.rename(self.root / INSTALLED / name)
        self.point_to(name, receipt)

    def point_to(self, name: str, receipt: bytes) -> None:
        """Make that installation current, with one rename; then replace the receipt.

        If the process is killed between the two, the receipt is of the one before.
        """
        link = self.root / f"{DRAFT}{secrets.token_hex(8)}"
        link.symlink_to(f"{INSTALLED}/{name}")
        draft = self._drafted(receipt, PUBLIC_MODE)
        sync_filesystem(self.root)
        link.rename(self.root / CURRENT)
        draft.rename(self.receipt)
        sync_folder(self.root)

    @property
    def receipt(self) -> Path:
        """The path of the receipt of the current installation."""
        return self.root / RECEIPT

    def save_receipt(self, receipt: bytes) -> None:
        """Replace the receipt of the current installation, atomically."""
        self._drafted(receipt, PUBLIC_MODE).rename(self.receipt)
        sync_folder(self.root)

    def _drafted(self, data: bytes, mode: int) -> Path:
        draft = self.root / f"{DRAFT}{secrets.token_hex(8)}"
        create(draft, data, mode=mode)
        return draft

    def tidy(self, answered: Iterable[str]) -> None:
        """Remove requests for `answered` all of whose keys are installed, and old installations."""
        current = self.current
        sets = current.sets if current else {}
        for name in answered:
            folder = self.request_folder(name)
            installed = {place: found.get(name, {}).get(KEY) for place, found in sets.items()}
            if folder.is_dir() and all(
                _files_in(folder / layout.in_set(place, "")).get(KEY) == installed.get(place)
                for place in _sets_in(folder)
            ):
                self.remove(folder)
        kept = {current.path.name, current.previous} if current else set()
        for number in self._numbers():
            if str(number) not in kept:
                self.remove(self.root / INSTALLED / str(number))

    def remove(self, folder: Path) -> None:
        """Remove `folder` atomically: rename it, then delete it."""
        spent = self.root / f"{DRAFT}{secrets.token_hex(8)}"
        folder.rename(spent)
        shutil.rmtree(spent)

    def _draft(self, sets: Mapping[str, Enclaves], record: Mapping[str, object]) -> Path:
        make_private(self.root / INSTALLED)
        draft = self.root / f"{DRAFT}{secrets.token_hex(8)}"
        make_private(draft)
        for place, enclaves in sets.items():
            for name, files in enclaves.items():
                folder = draft / layout.in_set(place, layout.enclave_folder(name))
                make_private(folder)
                for file, data in files.items():
                    create(folder / file, data, mode=PRIVATE_MODE if file in KEYS else PUBLIC_MODE)
        create(draft / RECORD, json.dumps(record, indent=2).encode() + b"\n", mode=PUBLIC_MODE)
        return draft

    def _numbers(self) -> list[int]:
        folder = self.root / INSTALLED
        there = list(folder.iterdir()) if folder.is_dir() else []
        return [int(each.name) for each in there if _NUMBER.fullmatch(each.name)]


@contextmanager
def changing(root: Path) -> Iterator[CredentialStore]:
    """The store at `root`, locked for this process, without temporary files of killed ones.

    A folder created for it is removed if nothing was stored. FileError if the disk refuses.
    KeystoreError if another process has the lock, or if another user could change or replace
    the folder or what is in it.
    """
    with disk_errors(root):
        _refuse_outsiders(root)
        new = not root.exists()
        make_private(root)
        with locked(root):
            try:
                sweep(root)
                yield CredentialStore(root)
            except BaseException:
                with suppress(OSError):  # the next command removes what is left
                    sweep(root)
                    if new:
                        root.rmdir()  # if it is empty
                raise


def _refuse_outsiders(root: Path) -> None:
    refuse_outsiders(
        (root, *(root / each for each in _OWN)),
        "a user who can write there could change this robot's credentials",
        instead="or choose another --dir",
        error=KeystoreError,
    )


@contextmanager
def one_command(root: Path) -> Iterator[None]:
    """One command at a time, for one that changes the store at `root` several times.

    KeystoreError if another is at work; other errors as of `changing`.
    """
    with changing(root) as store:
        store.refuse_without_links()
        make_private(root / REQUESTS)
    with disk_errors(root), locked(root / REQUESTS):
        yield


def _previous(text: str | None) -> str | None:
    """The number of the previous installation in a record; ValueError if it is not one."""
    if text is not None and not _NUMBER.fullmatch(text):
        raise ValueError(f"{text!r} is not the number of an installation")
    return text


def _sets_in(folder: Path) -> list[str]:
    """The sets for which the request in that folder has keys."""
    further = folder / layout.SETS
    return [layout.FIRST, *(each.name for each in (further.iterdir() if further.is_dir() else ()))]


def _files_in(folder: Path) -> dict[str, bytes]:
    return {name: read(folder / name) for name in (*FILES, PROOF) if (folder / name).is_file()}
