"""Temporary files and folders beside their target; what a killed command leaves is removed later.

A process holds a lock on each while it uses it (flock(2)), which the system ends with the process.
So the next one that makes a draft in the same folder removes those without a lock.
"""

import errno
import fcntl
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PREFIX = ".pqsec-"
_DRAFT = re.compile(r"\.pqsec-[0-9a-f]{16}")
_OLDER = r"\.{}\.[0-9a-f]{{16}}"
"""The name that earlier versions gave to drafts of a file, which they did not lock."""
_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
_CURRENT, _NO_REPLACE = -100, 1
"""AT_FDCWD and RENAME_NOREPLACE of renameat2(2)."""

Place = str | int
"""A folder: its path, or its descriptor."""
_left: dict[str, int] = {}
"""When each folder was last changed, by this process: it has no new drafts of others since."""


@contextmanager
def draft_file(folder: Place, name: str) -> Iterator[tuple[str, int]]:
    """A new empty file in `folder`, mode 0600: its name there, and a descriptor to write.

    It is removed at the end unless it was renamed. `name` is that of its target. OSError.
    """
    with swept(folder, name), _at(folder) as handle:
        draft, file = _claimed(handle, _make_file)
        try:
            yield draft, file
        finally:
            with suppress(FileNotFoundError):
                os.unlink(draft, dir_fd=handle)
            os.close(file)


@contextmanager
def draft_folder(folder: str) -> Iterator[str]:
    """The path of a new folder in `folder`, mode 0700, removed unless it was renamed. OSError."""
    sweep(folder)
    with _at(folder) as handle:
        name, lock = _claimed(handle, _make_folder)
    try:
        yield f"{folder}/{name}"
    finally:
        shutil.rmtree(f"{folder}/{name}", ignore_errors=True)
        os.close(lock)


def move_new(draft: Path, path: Path) -> None:
    """Give the file `draft` the name `path`, without replacing anything; OSError.

    FileExistsError if something is at `path`. Another name of the draft may stay.
    """
    try:
        os.link(draft, path)
    except FileExistsError:
        raise
    except OSError:  # exFAT and others have no hard links
        _rename_new(draft, path)


def _rename_new(draft: Path, path: Path) -> None:
    """Rename without replacing anything: by renameat2(2), else as the only pqsec in the folder."""
    import ctypes  # noqa: PLC0415 -- takes a millisecond, and few file systems need it

    names = (_CURRENT, os.fsencode(draft), _CURRENT, os.fsencode(path))
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename and rename(*names, _NO_REPLACE) == 0:
        return
    code = ctypes.get_errno() if rename else errno.ENOSYS
    if code not in {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP}:
        raise OSError(code, os.strerror(code), str(path))
    folder = os.open(path.parent, _FOLDER)
    try:
        with suppress(OSError):  # nor has every file system locks
            fcntl.flock(folder, fcntl.LOCK_EX)
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
        draft.rename(path)
    finally:
        os.close(folder)


@contextmanager
def swept(folder: Place, *names: str) -> Iterator[None]:
    """Within it, this process changes `folder`, after `sweep`."""
    clean = sweep(folder, *names)
    try:
        yield
    finally:
        if clean:
            _note(folder)


def sweep(folder: Place, *names: str) -> bool:
    """Remove drafts in `folder` that no process uses any more; whether none is left.

    Also those that earlier versions made for files of these names. What cannot be removed stays.
    """
    with suppress(OSError), _at(folder) as handle:
        changed = os.fstat(handle).st_mtime_ns
        if isinstance(folder, str) and _left.get(folder) == changed:
            return True
        older = [re.compile(_OLDER.format(re.escape(each))) for each in names]
        there = os.listdir(handle)  # noqa: PTH208 -- a Path has no handle
        drafts = [name for name in there if any(each.fullmatch(name) for each in (_DRAFT, *older))]
        left = [name for name in drafts if not _is_removed(handle, name)]
        if not left:
            _note(folder)
        return not left
    return False


def _note(folder: Place) -> None:
    """Record that `folder` has no drafts now."""
    if isinstance(folder, str):  # a descriptor may become that of another folder
        with suppress(OSError):
            _left[folder] = os.stat(folder).st_mtime_ns  # noqa: PTH116 -- as all here, without a Path


def _is_removed(folder: int, name: str) -> bool:
    """Whether the draft could be removed: it is this user's, and no process uses it."""
    with suppress(OSError):  # BlockingIOError if it is in use
        file = os.open(name, _READ, dir_fd=folder)
        try:
            found = os.fstat(file)
            if found.st_uid != os.geteuid():
                return False
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if stat.S_ISDIR(found.st_mode):
                shutil.rmtree(name, dir_fd=folder)
            else:
                os.unlink(name, dir_fd=folder)
            return True
        finally:
            os.close(file)
    return False


def _claimed(folder: int, make: Callable[[int, str], int]) -> tuple[str, int]:
    """A new name in `folder`, and the descriptor of what `make` made there, locked.

    Without a lock if the file system has none: there nothing is removed, either.
    """
    while True:
        name = f"{PREFIX}{os.urandom(8).hex()}"
        made = make(folder, name)
        with suppress(OSError):
            fcntl.flock(made, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):  # another process removed it before it was locked
            os.stat(name, dir_fd=folder, follow_symlinks=False)
            return name, made
        os.close(made)


def _make_file(folder: int, name: str) -> int:
    return os.open(name, _NEW, 0o600, dir_fd=folder)


def _make_folder(folder: int, name: str) -> int:
    with suppress(FileNotFoundError):
        os.mkdir(name, 0o700, dir_fd=folder)
        return os.open(name, _READ, dir_fd=folder)
    return os.dup(folder)  # it was removed already: `_claimed` makes another


@contextmanager
def _at(folder: Place) -> Iterator[int]:
    if isinstance(folder, int):
        yield folder
        return
    handle = os.open(folder, _FOLDER)
    try:
        yield handle
    finally:
        os.close(handle)
