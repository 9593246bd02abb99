"""Folders by descriptor: if a path is redirected meanwhile, work stays in the same folder.

The root is the folder that the user named; a link may lead to it. Below it no link is
followed: each part of a path is opened from the folder above it, with O_NOFOLLOW.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._drafts import draft_file
from pqsec_pki._files import PRIVATE_MODE, fill
from pqsec_pki._owners import outsider, way_out
from pqsec_pki.errors import KeystoreError

_OPEN = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
OTHERS = "anyone who may write there can change what pqsec does"
_FOLDER_MODE = 0o755
"""Only the owner may write in a new folder, whatever the umask."""


@dataclass(frozen=True, slots=True)
class Folder:
    """An open folder. OSErrors name the file by its path."""

    handle: int
    path: str
    """The path, for messages only."""

    @classmethod
    @contextmanager
    def opened(cls, path: Path) -> Iterator[Self]:
        """Open the folder at `path`, following links; OSError if there is none."""
        handle = os.open(path, _OPEN)
        try:
            yield cls(handle, str(path))
        finally:
            os.close(handle)

    @contextmanager
    def below(self, place: str, *, make: bool = False) -> Iterator["Folder"]:
        """Open the folder at `place`, relative to this one; create missing parts if `make`.

        KeystoreError if any part is a link or a file, FileNotFoundError if it is missing.
        """
        handle, path = os.dup(self.handle), self.path
        try:
            for name in parts(place):
                path = f"{path}/{name}"
                above, handle = handle, _open(handle, name, path, make=make)
                os.close(above)
            yield Folder(handle, path)
        finally:
            os.close(handle)

    def kind(self, place: str) -> int | None:
        """The file type bits at `place`, without following a link; None if nothing is there."""
        try:
            return stat.S_IFMT(os.lstat(f"{place}", dir_fd=self.handle).st_mode)
        except (FileNotFoundError, NotADirectoryError):
            return None

    def replace(self, name: str, data: bytes) -> None:
        """Write `data` to `name`, readable by its owner only, with one rename.

        KeystoreError if another user owns the folder or may write in it.
        """
        self.refuse_outsiders()
        with draft_file(self.handle, name) as (draft, file):
            fill(file, data, mode=PRIVATE_MODE, sync=True)
            os.replace(draft, name, src_dir_fd=self.handle, dst_dir_fd=self.handle)

    @property
    def names(self) -> list[str]:
        """The names in the folder."""
        return os.listdir(self.handle)  # noqa: PTH208 -- a Path has no handle

    @property
    def mode(self) -> int:
        """Its permission bits."""
        return os.fstat(self.handle).st_mode & 0o777

    def refuse_outsiders(self) -> None:
        """KeystoreError if another user owns the folder or may write in it."""
        _refuse(os.fstat(self.handle), self.handle, self.path)

    def refuse_outsiders_of(self, place: str) -> int | None:
        """The file type bits at `place`, as of `kind`.

        KeystoreError if another user owns the file or folder there, or may write there.
        """
        try:
            found = os.lstat(place, dir_fd=self.handle)
        except (FileNotFoundError, NotADirectoryError):
            return None
        path = f"{self.path}/{place}".removesuffix("/.")
        _refuse(found, f"/proc/self/fd/{self.handle}/{place}", path)
        return stat.S_IFMT(found.st_mode)


def _refuse(found: os.stat_result, place: str | int, path: str) -> None:
    """KeystoreError if another user owns what is at `place`, or may write there."""
    if who := outsider(found, place):
        raise KeystoreError(f"{path}: {who}; {OTHERS}", hint=way_out(found, path))


def parts(place: str) -> list[str]:
    """The parts of the path `place`; none for the folder itself."""
    return [name for name in place.split("/") if name not in {"", "."}]


def should_be(path: str, what: str) -> KeystoreError:
    """The error for a link, or for anything else in the keystore that is not a `what`."""
    return KeystoreError(f"{path} should be a {what}, and is not", hint="move it away")


def _open(above: int, name: str, path: str, *, make: bool) -> int:
    try:
        if make:
            with suppress(FileExistsError):
                os.mkdir(name, _FOLDER_MODE, dir_fd=above)
        return os.open(name, _OPEN | os.O_NOFOLLOW, dir_fd=above)
    except NotADirectoryError:  # a link too, with both flags
        raise should_be(path, "folder") from None
    except OSError as error:
        error.filename = path
        raise
