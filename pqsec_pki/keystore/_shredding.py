"""Private keys that go: held by a second name until the change is done, then zeroed.

Zeros reach the blocks that the file had on ext4, XFS and other file systems that write in
place. On btrfs, ZFS, an SSD's spare blocks, snapshots and backups the old bytes may stay.
"""

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

FOLDER = "spent"
"""Inside a drafted change: the files that it does away with."""


def hold(draft: Path, path: str) -> None:
    """Give the file at `path` a second name in the drafted change, if it is there."""
    folder = draft / FOLDER
    folder.mkdir(mode=0o700, exist_ok=True)
    with suppress(FileNotFoundError):
        if stat.S_ISREG(os.lstat(path).st_mode):
            os.link(path, folder / secrets.token_hex(8))


def shred(change: Path) -> None:
    """Overwrite what the change held, once its own names are gone; may be repeated.

    A file that still has another name is somebody's own copy, and stays.
    """
    folder = change / FOLDER
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        found = path.lstat()
        if found.st_nlink == 1:
            _zero(path, found.st_size)


def _zero(path: Path, size: int) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_NOFOLLOW)
    try:
        rest = size
        while rest > 0:
            rest -= os.write(handle, bytes(rest))
        os.fsync(handle)
    finally:
        os.close(handle)
