"""A folder with copies of keys, which is removed even if the process is killed."""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki.errors import FileError
from pqsec_pki.migration import _remover


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder for its owner alone, removed at the end; FileError if that fails.

    A second process waits at a pipe that ends with this one, and removes the folder: a `kill -9`
    must not leave keys behind.
    """
    folder = Path(tempfile.mkdtemp(prefix="pqsec-migrate-"))
    try:
        with _removing_later(folder):
            yield folder
    finally:
        _remove(folder)


def _removing_later(folder: Path) -> subprocess.Popen[bytes]:
    program = [sys.executable, "-I", _remover.__file__, str(folder)]
    try:
        return subprocess.Popen(  # noqa: S603 -- this Python, with a program of this package
            program, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
        )
    except OSError as error:
        raise FileError(f"cannot be watched by a second process ({error})", where=folder) from None


def _remove(folder: Path) -> None:
    try:
        _remover.remove(folder)
    except OSError as error:
        raise FileError(
            f"has copies of private keys, and cannot be removed ({error.strerror})",
            where=folder,
            hint="remove it yourself",
        ) from None
