"""Private keys that go: held by a second name until the change is done, then zeroed.

Zeros reach the blocks that the file had on ext4, XFS and other file systems that write in
place. On btrfs, ZFS, an SSD's spare blocks, snapshots and backups the old bytes may stay.
"""

import os
import secrets
import stat
from contextlib import suppress

from pqsec_pki.keystore._folder import Folder

FOLDER = "spent"
"""Inside a drafted change: the files that it does away with."""
_PIECE = 1 << 20
_WRITE = os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def hold(change: Folder, folder: Folder, name: str) -> None:
    """Give the file `name` in `folder` a second name in the drafted change, if it is there."""
    with suppress(FileExistsError):
        os.mkdir(FOLDER, 0o700, dir_fd=change.handle)
    if folder.kind(name) != stat.S_IFREG:
        return
    with change.below(FOLDER) as spent:
        os.link(
            *(name, secrets.token_hex(8)),
            src_dir_fd=folder.handle,
            dst_dir_fd=spent.handle,
            follow_symlinks=False,
        )


def shred(change: Folder) -> None:
    """Overwrite what the change held, once its own names are gone; may be repeated.

    A file that still has another name is somebody's own copy, and stays. So does what no
    change holds: another's file, or what a link shows.
    """
    if change.kind(FOLDER) is None:
        return
    with change.below(FOLDER) as spent:
        spent.refuse_outsiders()
        for name in spent.names:
            if spent.kind(name) == stat.S_IFREG:
                _zero(spent, name)


def _zero(spent: Folder, name: str) -> None:
    handle = os.open(name, _WRITE, dir_fd=spent.handle)
    try:
        found = os.fstat(handle)
        own = stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid()
        if not own or found.st_nlink != 1:
            return
        rest = found.st_size
        while rest > 0:
            rest -= os.write(handle, bytes(min(rest, _PIECE)))
        os.fsync(handle)
    finally:
        os.close(handle)
