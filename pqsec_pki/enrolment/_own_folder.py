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
from pqsec_pki._owners import outsider, way_out
from pqsec_pki.errors import KeystoreError

DRAFT = ".draft-"
_PRIVATE_FOLDER = 0o700
_DRAFTED = re.compile(r"(\.draft-|\.bundle\.(key|pub)\.pem\.|\.server\.json\.)[0-9a-f]{16}")
"""Names of files that a killed process leaves; the folder may contain files of others. Earlier
versions also made drafts of two files."""


def make_private(folder: Path) -> None:
    """Create `folder` and missing parents, mode 0700; an existing folder stays as it is."""
    for each in (*reversed(folder.parents), folder):
        if not each.is_dir():
            each.mkdir(mode=_PRIVATE_FOLDER)
            each.chmod(_PRIVATE_FOLDER)


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """Lock the folder for this process; KeystoreError if another process has the lock."""
    handle = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with unshared(handle):
            lock(handle, fcntl.LOCK_EX)
            yield
    except BlockingIOError:
        raise KeystoreError(f"{root}: another pqsec command is using this folder") from None
    finally:
        os.close(handle)


def refuse_outsiders(root: Path) -> None:
    """KeystoreError unless only the caller can change the folder, as with sshd's StrictModes.

    The folders above must be the caller's or root's. A user who can write in one of them could
    rename this folder and put a link or another folder in its place, except in a sticky
    folder such as /tmp. Links on the path are checked too. Later code may then use paths.
    """
    given, real = root.absolute(), Path(os.path.realpath(root))
    for path in dict.fromkeys((*given.parents, given, *real.parents, real)):
        try:
            found = path.lstat()
        except FileNotFoundError:
            continue
        above = path != real
        if who := outsider(found, roots=above, sticky=above):
            raise KeystoreError(
                f"{path}: {who}; a user who can write there could change this robot's credentials",
                hint=f"{way_out(found, str(path))}; or choose another --dir",
            )


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
