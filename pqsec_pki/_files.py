"""Read files with clear errors; write them atomically.

A file is written beside its target and then linked or renamed to it, so a reader sees the
old content or the new one, never a part, also where there are no hard links. Private files are
0600 whatever the umask.
"""

import errno
import os
import select
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import FileIO
from pathlib import Path

from pqsec_pki._drafts import draft_file, draft_folder, move_new, swept
from pqsec_pki._owners import user
from pqsec_pki.errors import ExistsError, FileError, MissingError

MAX_FILE = 8 << 20
"""Bytes. The largest document that any stack was measured to accept is 0.5 MB."""

PIPE_PATIENCE = 5.0
"""Seconds to wait for a writer of a pipe; a writer may take any time."""

_PIECE = 1 << 16
"""Bytes that are read at once beyond the size that the system reports: that of a pipe is 0."""
_KINDS = {
    errno.EEXIST: ExistsError,
    errno.ENOENT: MissingError,
    errno.ENOTDIR: MissingError,
}
_CHOOSE = "choose another place, or --force to replace it"
_NOWHERE = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP)
"""ELOOP is for a link that points to itself."""

PUBLIC_MODE = 0o644
PRIVATE_MODE = 0o600
_FOLDER = os.O_RDONLY | os.O_DIRECTORY
_UNNAMED = getattr(os, "O_TMPFILE", 0)

FileVersion = tuple[int, ...]
"""Inode, size and times of a file: another after it was changed. Empty if it is not there."""
_seen: ContextVar[dict[Path, FileVersion] | None] = ContextVar("seen", default=None)


def read(path: Path, *, limit: int = MAX_FILE) -> bytes:
    """The bytes of `path`; FileError if it cannot be read or is over `limit` bytes.

    A pipe is read to its end, and refused if it gets no writer within PIPE_PATIENCE.
    """
    if (seen := _seen.get()) is not None:
        seen.setdefault(path, file_version(path))  # before it is read: no change is missed
    try:
        with open(path, "rb", buffering=0, opener=_without_waiting) as file:
            return _all_of(file, path, limit)
    except (OSError, ValueError) as error:
        raise _refused(path, error) from error


def file_version(path: Path) -> FileVersion:
    """The version of the file at `path`."""
    with suppress(OSError, ValueError):
        found = path.stat()
        return found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns
    return ()


@contextmanager
def noted(seen: dict[Path, FileVersion]) -> Iterator[None]:
    """Within it, `read` enters each file into `seen`, also one that cannot be read."""
    token = _seen.set(seen)
    try:
        yield
    finally:
        _seen.reset(token)


def real_path(path: Path) -> str:
    """The path with all links resolved, for `read_within`."""
    return os.path.realpath(path)


def read_within(root: str, path: Path, *, follow: bool, limit: int = MAX_FILE) -> bytes:
    """The bytes of a file below `root`, a `real_path`; links on its path are resolved.

    FileError if a link leads out of `root`: otherwise a folder made by another user could
    make pqsec copy any file of the caller. Unless `follow`, `path` itself must not be a link.
    """
    flags = 0 if follow else os.O_NOFOLLOW
    try:
        with open(
            path, "rb", buffering=0, opener=lambda path, mode: _without_waiting(path, mode | flags)
        ) as file:
            # Opened once, so no race. Not by pathlib: bundles are made of thousands of files.
            place = os.readlink(f"/proc/self/fd/{file.fileno()}")  # noqa: PTH115
            if not place.startswith(os.path.join(root, "")):  # noqa: PTH118
                raise FileError(
                    f"{path} leads out of {root}",
                    hint="replace the link by a copy of the file it should point to",
                )
            return _all_of(file, path, limit)
    except (OSError, ValueError) as error:
        raise _refused(path, error) from error


def _all_of(file: FileIO, path: Path, limit: int) -> bytes:
    found = os.fstat(file.fileno())
    pieces = [_begin(file) if stat.S_ISFIFO(found.st_mode) else b""]
    if not stat.S_ISREG(found.st_mode):
        os.set_blocking(file.fileno(), True)
    size, most = len(pieces[0]), found.st_size + 1  # `read` takes memory for what it is asked
    while size <= limit and (piece := file.read(min(most, limit + 1 - size))):
        pieces.append(piece)
        size, most = size + len(piece), _PIECE
    if size > limit:
        raise FileError(f"larger than {limit} bytes, so it cannot be the expected file", where=path)
    return b"".join(pieces)


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)


def _begin(pipe: FileIO) -> bytes:
    """The first byte of a pipe, once there is one."""
    handle, byte = pipe.fileno(), b""
    waiting = select.poll()
    waiting.register(handle, select.POLLIN)
    came = waiting.poll(PIPE_PATIENCE * 1000)
    with suppress(BlockingIOError):  # there is a writer; it may take any time
        byte = os.read(handle, 1)
        if not (byte or came):
            raise TimeoutError(errno.ETIMEDOUT, "a pipe without a writer")
    return byte


def is_there(path: Path) -> bool:
    """Whether `path` exists; Path.exists raises if a name is too long or a folder inaccessible."""
    return os.path.exists(path)  # noqa: PTH110 -- see above


def is_folder(path: Path) -> bool:
    """Whether `path` is a folder; Path.is_dir raises in the cases where Path.exists does."""
    return os.path.isdir(path)  # noqa: PTH112 -- see above


def resolved(path: Path) -> Path:
    """`path` without links; Path.resolve raises RuntimeError if a link points to itself."""
    return Path(os.path.realpath(path))


def exists(path: Path | str, *, follow: bool = True) -> bool:
    """Whether `path`, or the target of a link there, exists; FileError if that cannot be known.

    In an inaccessible folder os.path.exists, and Path.exists of newer Pythons, return False.
    """
    try:
        os.stat(path, follow_symlinks=follow)  # noqa: PTH116 -- faster, for thousands of files
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno in _NOWHERE:
            return False
        raise _refused(path, error) from error
    return True


def walk(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Each folder below `root`, and `root`, with the names in it; no link is followed.

    FileError for a folder that cannot be read, so that it does not count as empty, and for a
    link to a folder, since opening a path would follow it. Path.rglob and Path.glob skip both
    without an error.
    """

    def refuse(error: OSError) -> None:
        folder = Path(error.filename)
        if folder == root or not isinstance(
            error, FileNotFoundError
        ):  # else it was removed meanwhile
            raise _refused(folder, error) from error

    for folder, folders, names in os.walk(root, onerror=refuse):
        folders.sort()
        for name in folders:
            if os.path.islink(f"{folder}/{name}"):  # noqa: PTH114 -- no error where it is closed
                path = Path(folder, name)
                hint = "replace the link by the folder itself, or remove the link"
                raise FileError("a link to a folder, which is not followed", where=path, hint=hint)
        yield Path(folder), [*folders, *names]


def refuse_existing(path: Path, *, replaceable: bool = True) -> None:
    """ExistsError if anything is at `path`, including a broken link.

    The hint names --force if it is `replaceable`.
    """
    if os.path.lexists(path):
        hint = _CHOOSE if replaceable else "choose another place, or remove it first"
        raise ExistsError(f"{path} exists", hint=hint)


def write(path: Path, data: bytes, *, private: bool = False, force: bool = False) -> None:
    """Write `data` to `path`; it is durable when this returns.

    Without `force` an existing file stays and ExistsError is raised. A symbolic link
    at `path` is itself replaced, never followed. FileError if the folder refuses.
    """
    mode = PRIVATE_MODE if private else PUBLIC_MODE
    try:
        if force:
            _refuse_devices(path)
        with swept(str(path.parent), path.name):
            if not _is_written_unnamed(path, data, mode):
                with draft_file(str(path.parent), path.name) as (name, handle):
                    fill(handle, data, mode=mode, sync=True)
                    if force:
                        path.with_name(name).replace(path)
                    else:
                        move_new(path.with_name(name), path)
        sync_folder(path.parent)
    except FileExistsError as error:
        raise ExistsError(f"{path} exists", hint=_CHOOSE) from error
    except (OSError, ValueError) as error:
        raise _refused(path, error) from error


def _is_written_unnamed(path: Path, data: bytes, mode: int) -> bool:
    """Whether `data` is now in the new file `path`, which had no name before: a kill leaves none.

    False if there is a file, or if the file system has no such files or no hard links.
    """
    if _UNNAMED and not os.path.lexists(path):
        with suppress(OSError):
            handle = os.open(path.parent, _UNNAMED | os.O_WRONLY | os.O_CLOEXEC, PRIVATE_MODE)
            try:
                fill(handle, data, mode=mode, sync=True)
                folder = os.open(path.parent, _FOLDER)
                try:
                    os.link(f"/proc/self/fd/{handle}", path.name, dst_dir_fd=folder)
                finally:
                    os.close(folder)
                return True
            finally:
                os.close(handle)
    return False


def refuse_without_links(folder: Path, what: str, *, hard: bool = False) -> None:
    """FileError if the file system of `folder`, which may be new, has no symbolic links.

    With `hard` it needs hard links too; `what` needs them. It is asked in a draft.
    """
    place = next((each for each in (folder, *folder.parents) if exists(each)), folder)
    with disk_errors(folder, drafting=True), draft_folder(str(place)) as draft:
        create(f"{draft}/file", b"", mode=PRIVATE_MODE)
        try:
            Path(draft, "link").symlink_to("file")
            if hard:
                os.link(f"{draft}/file", f"{draft}/name")
        except OSError as error:
            if error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO}:
                raise
            raise FileError(
                f"has a file system without links, which {what} needs",
                where=folder,
                hint="choose a folder on ext4, XFS or Btrfs; exFAT and FAT are for bundles,"
                " requests, lists and reports",
            ) from error


def _refuse_devices(path: Path) -> None:
    """Refuse to replace anything but a file or a link, such as /dev/null."""
    with suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode)):
            raise OSError(errno.EPERM, "not a file", str(path))


def create(
    path: Path | str, data: bytes, *, mode: int, sync: bool = False, folder: int | None = None
) -> None:
    """Create the new file `path` with exactly `mode`; OSError as the system raises it.

    With `folder`, the descriptor of a folder, `path` is relative to it.
    """
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_MODE, dir_fd=folder)
    try:
        fill(handle, data, mode=mode, sync=sync)
    finally:
        os.close(handle)


def fill(handle: int, data: bytes, *, mode: int, sync: bool) -> None:
    """Write `data` to a new file that only its owner may read, and set `mode`; OSError."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(handle, rest) :]
    if mode != PRIVATE_MODE:
        os.fchmod(handle, mode)
    if sync:
        os.fsync(handle)


@contextmanager
def disk_errors(place: Path, *, drafting: bool = False) -> Iterator[None]:
    """Turn errors of the system into FileError, for the file they name, or else for `place`.

    Always for `place` when `drafting`: the files are temporary, with names that no user knows.
    """
    try:
        yield
    except OSError as error:
        named = None if drafting else error.filename2 or error.filename
        raise _refused(named or place, error) from error


def sync_folder(folder: Path) -> None:
    """Make the directory entries of `folder` durable."""
    handle = os.open(folder, _FOLDER)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_filesystem(folder: Path | int) -> None:
    """Make everything written so far on the file system durable: one call for many.

    The file system of `folder`, a path or a descriptor.
    """
    import ctypes  # noqa: PLC0415 -- takes a millisecond, and few commands need it

    handle = os.open(folder, _FOLDER) if isinstance(folder, Path) else os.dup(folder)
    try:
        syncfs = getattr(ctypes.CDLL(None, use_errno=True), "syncfs", None)
        if syncfs is None:  # not Linux
            os.sync()
        elif syncfs(handle) != 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code), str(folder))
    finally:
        os.close(handle)


def _refused(path: Path | str, error: OSError | ValueError) -> FileError:
    if not isinstance(error, OSError):
        return FileError(str(error).lower(), where=path)
    kind = _KINDS.get(error.errno or 0, FileError)
    hint = _owner_of(path) if isinstance(error, PermissionError) else None
    return kind((error.strerror or str(error)).lower(), where=path, hint=hint)


def _owner_of(path: Path | str) -> str | None:
    """A hint if `path`, or the folder that hides it, belongs to another user."""
    for each in (Path(path), *Path(path).parents):
        with suppress(OSError):
            number = each.stat().st_uid
            owner = user(number)
            who = f"{each} belongs to another user ({owner})"
            return f"{who}: run pqsec as {owner}, or ask for access" * (number != os.geteuid())
    return None
