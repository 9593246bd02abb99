"""A folder that is the caller's alone: nobody else changes it, and one process at a time does."""

import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki._owners import outsider, way_out
from pqsec_pki.errors import KeystoreError

DRAFT = ".draft-"
_PRIVATE_FOLDER = 0o700
_DRAFTED = re.compile(r"(\.draft-|\.bundle\.(key|pub)\.pem\.)[0-9a-f]{16}")
"""What a killed process leaves; the folder may have files of others."""


def make_private(folder: Path) -> None:
    """`folder` and what is missing above it, for their owner only; one that is there stays."""
    for each in (*reversed(folder.parents), folder):
        if not each.is_dir():
            each.mkdir(mode=_PRIVATE_FOLDER)
            each.chmod(_PRIVATE_FOLDER)


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """For one process at a time; KeystoreError if another has it."""
    handle = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise KeystoreError(f"{root}: another pqsec command is at work here") from None
    finally:
        os.close(handle)


def refuse_outsiders(root: Path) -> None:
    """As sshd's StrictModes: the folder is the caller's alone, and those above theirs or root's.

    Who may write in a folder above can rename this one, and put a link or a folder of their
    own in its place; in a sticky one such as /tmp they cannot. Links on the way count too.
    So what follows may go by paths. KeystoreError if not.
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
                f"{path}: {who}; who may write there could change what this robot runs with",
                hint=f"{way_out(found, str(path))}; or choose another --dir",
            )


def sweep(root: Path) -> None:
    """Remove drafts of sets and requests, of the link, and of the key that opens bundles."""
    for leftover in filter(_is_draft, root.iterdir()):
        if leftover.is_symlink() or leftover.is_file():
            leftover.unlink()
        else:
            shutil.rmtree(leftover)


def _is_draft(path: Path) -> bool:
    return _DRAFTED.fullmatch(path.name) is not None
