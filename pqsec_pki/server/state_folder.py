"""The folder with the signer's socket: nobody else may write there, and one signer uses it."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki._files import disk_errors
from pqsec_pki._locks import lock, unshared
from pqsec_pki._places import open_place
from pqsec_pki.errors import FileError
from pqsec_pki.server.configuration import ServerSettings
from pqsec_pki.server.signer import give_to


def make_state(settings: ServerSettings) -> None:
    """Make the state folder: for its owner, or also for the group of `front_user`.

    FileError for one where others could put a socket of theirs: the front would send it tokens;
    and for a folder of requests where others could put a request, or a pipe that never ends.
    """
    found = _own_folder(settings.state, "the signer cannot listen there")
    if settings.requests:
        _own_folder(settings.requests, "requests cannot wait there")
    if settings.front_user and found.st_uid == os.geteuid():
        with disk_errors(settings.state):
            settings.state.chmod(0o750)  # whatever the umask is
            give_to(settings.state, settings.front_user)


def _own_folder(path: Path, what: str) -> os.stat_result:
    """Make the folder, unless it is there; FileError, with `what`, if others may write there."""
    _refuse_open(path, what)
    with disk_errors(path):
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.stat()
    _refuse_open(path, what)
    return found


def _refuse_open(path: Path, what: str, owner: int | None = None) -> None:
    """FileError, with `what`, if another user could change the folder, or one above it."""
    if found := open_place(path, roots=True, owner=owner):
        raise FileError(f"{found.path}: {what}: {found.who}", hint=found.remedy)


def refuse_open_front(settings: ServerSettings) -> None:
    """FileError if others could listen in place of the signer, or give the server another key.

    For the process that faces the network, which would send them tokens. The signer's user owns the
    state folder, or makes it in a folder of its own.
    """
    with disk_errors(settings.state):
        there = settings.state if settings.state.exists() else settings.state.parent
        owner = there.stat().st_uid
    _refuse_open(settings.state, "the signer cannot be reached there", owner)
    for path in (file for each in settings.tls for file in (each.chain, each.key)):
        _refuse_open(path, "it cannot be the server's", owner)


@contextmanager
def state_held(settings: ServerSettings) -> Iterator[None]:
    """Make the state folder and keep other signers out, which would take the socket of this one.

    FileError if there is one. The lock ends with the process, whatever ends it.
    """
    make_state(settings)
    with disk_errors(settings.state):
        folder = os.open(settings.state, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with unshared(folder):
            _lock(folder, settings)
            yield
    finally:
        os.close(folder)


def _lock(folder: int, settings: ServerSettings) -> None:
    try:
        lock(folder, fcntl.LOCK_EX)
    except BlockingIOError:
        raise FileError(
            f"{settings.state}: another server uses this folder",
            hint="end it; or, for several servers, give each a `state` of its own in serve.yaml",
        ) from None
