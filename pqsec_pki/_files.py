"""Reading files with clear refusals; writing them atomically.

A file is written beside its place and then linked or renamed into it, so a reader sees
the old bytes or the new ones, never half. Private files are 0600 whatever the umask.
"""

import errno
import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

from pqsec_pki.errors import ExistsError, FileError

MAX_FILE = 8 << 20
"""Bytes. The largest document any stack was measured to take is 0.5 MB."""

PUBLIC_MODE = 0o644
PRIVATE_MODE = 0o600


def read(path: Path, *, limit: int = MAX_FILE) -> bytes:
    """The bytes of `path`; FileError if it cannot be read or is over `limit` bytes."""
    try:
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except (OSError, ValueError) as error:
        raise _refused(path, error) from error
    if len(data) > limit:
        raise FileError(f"{path}: larger than {limit} bytes, so not what is expected here")
    return data


def refuse_existing(path: Path) -> None:
    """ExistsError if anything is at `path`, were it a link that leads nowhere."""
    if os.path.lexists(path):
        raise ExistsError(f"{path} exists", hint="choose another place, or --force to replace it")


def write(path: Path, data: bytes, *, private: bool = False, force: bool = False) -> None:
    """Put `data` at `path`, durable when this returns.

    Without `force` an existing file stays and ExistsError is raised. A symbolic link
    at `path` is itself replaced, never followed. FileError if the folder refuses.
    """
    try:
        draft = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
        try:
            create(draft, data, mode=PRIVATE_MODE if private else PUBLIC_MODE, sync=True)
            if force:
                _refuse_devices(path)
                draft.replace(path)
            else:
                os.link(draft, path)
        finally:
            draft.unlink(missing_ok=True)
        sync_folder(path.parent)
    except FileExistsError as error:
        raise ExistsError(
            f"{path} exists", hint="choose another place, or --force to replace it"
        ) from error
    except (OSError, ValueError) as error:
        raise _refused(path, error) from error


def _refuse_devices(path: Path) -> None:
    """A file or a link is replaced; /dev/null and its like are not."""
    with suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode)):
            raise OSError(errno.EPERM, "not a file", str(path))


def create(path: Path | str, data: bytes, *, mode: int, sync: bool = False) -> None:
    """Make the new file `path` with exactly `mode`; OSError as the system gives it."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_MODE)
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(handle, rest) :]
        if mode != PRIVATE_MODE:
            os.fchmod(handle, mode)
        if sync:
            os.fsync(handle)
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Make the names in `folder` durable."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_filesystem(folder: Path) -> None:
    """Make everything written so far on `folder`'s file system durable: one call for many."""
    import ctypes  # noqa: PLC0415 -- costs a millisecond that most commands need not pay

    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        syncfs = getattr(ctypes.CDLL(None, use_errno=True), "syncfs", None)
        if syncfs is None:  # not Linux
            os.sync()
        elif syncfs(handle) != 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code), str(folder))
    finally:
        os.close(handle)


def _refused(path: Path, error: OSError | ValueError) -> FileError:
    reason = error.strerror if isinstance(error, OSError) else None
    refusal = FileError((reason or str(error)).lower())
    refusal.where = str(path)
    return refusal
