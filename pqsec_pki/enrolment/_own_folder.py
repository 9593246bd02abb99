"""A folder that only the caller can change, one process at a time."""

import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki import _drafts
from pqsec_pki._locks import lock, unshared
from pqsec_pki._places import make_folders
from pqsec_pki.errors import KeystoreError

DRAFT = ".draft-"
_PRIVATE_FOLDER = 0o700
_DRAFTED = re.compile(r"(\.draft-|\.bundle\.(key|pub)\.pem\.|\.server\.json\.)[0-9a-f]{16}")
"""Names of files that a killed process leaves; the folder may contain files of others. Earlier
versions also made drafts of two files."""


def make_private(folder: Path) -> None:
    """Create `folder` and missing parents, mode 0700; an existing folder stays as it is."""
    make_folders(folder, _PRIVATE_FOLDER)


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """Lock the folder for this process.

    KeystoreError if another process has the lock, or had it and removed the folder meanwhile.
    """
    in_use = KeystoreError(f"{root}: another pqsec command is using this folder")
    try:
        handle = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    except FileNotFoundError:
        raise in_use from None
    try:
        with unshared(handle):
            lock(handle, fcntl.LOCK_EX)
            if not _is_still(root, handle):
                raise in_use
            yield
    except BlockingIOError:
        raise in_use from None
    finally:
        os.close(handle)


def _is_still(root: Path, handle: int) -> bool:
    """Whether the folder at that path is the one that was opened."""
    try:
        return os.path.samestat(root.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


def sweep(root: Path) -> None:
    """Remove temporary files of killed commands: sets, requests, the link, the sealing key.

    Only for who has the lock.
    """
    _drafts.sweep(str(root))
    for leftover in filter(_is_draft, root.iterdir()):
        if leftover.is_symlink() or leftover.is_file():
            leftover.unlink()
        else:
            shutil.rmtree(leftover)


def _is_draft(path: Path) -> bool:
    return _DRAFTED.fullmatch(path.name) is not None
