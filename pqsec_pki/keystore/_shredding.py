"""Overwrites removed private keys: a hard link keeps each until the change is done.

On ext4, XFS and other file systems that write in place, the zeros replace the file's blocks.
On btrfs, ZFS, an SSD's spare blocks, snapshots and backups the old bytes may remain.
"""

import errno
import os
import secrets
import stat
from contextlib import suppress

from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore._folder import Folder

FOLDER = "spent"
"""Folder in a staged change: hard links to the files that it removes."""
_PIECE = 1 << 20
_NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}
_WRITE = os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def hold(change: Folder, folder: Folder, name: str) -> None:
    """Create a hard link to the file `name` of `folder` in the staged change, if it exists."""
    if folder.kind(name) != stat.S_IFREG:
        return
    with suppress(FileExistsError):
        os.mkdir(FOLDER, 0o700, dir_fd=change.handle)
    with change.below(FOLDER) as spent:
        try:
            os.link(
                *(name, secrets.token_hex(8)),
                src_dir_fd=folder.handle,
                dst_dir_fd=spent.handle,
                follow_symlinks=False,
            )
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            raise KeystoreError(
                f"{folder.path}: the file system has no hard links, with which old keys are"
                " overwritten",
                hint="move the keystore to ext4, XFS or Btrfs",
            ) from error


def shred(change: Folder) -> None:
    """Overwrite the files that `hold` kept; may be repeated.

    Files with another hard link are a user's own copies and are kept; so are files of another
    user, and targets of links.
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
