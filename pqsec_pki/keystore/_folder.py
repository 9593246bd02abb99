"""Folders by handle: whatever a path is made to lead to meanwhile, work stays in the same folder.

The root is what the user named, and may be named by a link. Below it no link is followed:
each part of a place is opened from the folder above it, with O_NOFOLLOW.
"""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from pqsec_pki._files import PRIVATE_MODE, create
from pqsec_pki._owners import outsider, way_out
from pqsec_pki.errors import KeystoreError

_OPEN = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_FOLDER_MODE = 0o755
"""Nobody else may write in a folder that is made here, whatever the umask."""


@dataclass(frozen=True, slots=True)
class Folder:
    """A folder that is open. OSErrors name the file by its path."""

    handle: int
    path: str
    """For messages only."""

    @classmethod
    @contextmanager
    def opened(cls, path: Path) -> Iterator[Self]:
        """The folder at `path`, where links may lead; OSError if there is none."""
        handle = os.open(path, _OPEN)
        try:
            yield cls(handle, str(path))
        finally:
            os.close(handle)

    @contextmanager
    def below(self, place: str, *, make: bool = False) -> Iterator["Folder"]:
        """The folder at `place`, relative to this one; made where it is missing, if `make`.

        KeystoreError if any part of it is a link or a file, FileNotFoundError if it is not
        there.
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
        """The type bits of what is at `place`, a link as a link; None if nothing is."""
        try:
            return stat.S_IFMT(os.lstat(f"{place}", dir_fd=self.handle).st_mode)
        except (FileNotFoundError, NotADirectoryError):
            return None

    def replace(self, name: str, data: bytes) -> None:
        """Put `data` at `name`, for its owner only, in one rename.

        KeystoreError if the folder is another's, or another may write in it.
        """
        self.refuse_outsiders()
        transaction = f".{name}.{secrets.token_hex(8)}"
        try:
            create(transaction, data, mode=PRIVATE_MODE, sync=True, folder=self.handle)
            os.replace(transaction, name, src_dir_fd=self.handle, dst_dir_fd=self.handle)
        except BaseException:
            with suppress(FileNotFoundError):
                os.unlink(transaction, dir_fd=self.handle)
            raise

    @property
    def names(self) -> list[str]:
        """What is in it."""
        return os.listdir(self.handle)  # noqa: PTH208 -- a Path has no handle

    @property
    def mode(self) -> int:
        """Its permission bits."""
        return os.fstat(self.handle).st_mode & 0o777

    def refuse_outsiders(self) -> None:
        """KeystoreError if it is another's, or another may write in it."""
        refuse_outsiders(os.fstat(self.handle), self.path)


def refuse_outsiders(found: os.stat_result, path: str) -> None:
    """KeystoreError if what was found at `path` is another's, or another may write there."""
    if who := outsider(found):
        words = f"{path}: {who}; who may write there could change what pqsec does"
        raise KeystoreError(words, hint=way_out(found, path))


def parts(place: str) -> list[str]:
    """The names that lead to `place`; none for the folder itself."""
    return [name for name in place.split("/") if name not in {"", "."}]


def should_be(path: str, what: str) -> KeystoreError:
    """The refusal of a link, or of anything else that is not `what`, in the keystore."""
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
