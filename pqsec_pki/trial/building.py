"""Peers: compiled when they are first needed, and kept."""

import hashlib
import os
import shutil
import signal
import stat
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pqsec_pki._files import disk_errors
from pqsec_pki.errors import FileError, PqsecError, shown
from pqsec_pki.trial.installation import MACHINE, Installation
from pqsec_pki.vendors.elf import read_library

PATIENCE = 300
"""Seconds for one command of a compiler."""
_SOURCES = Path(__file__).parent / "peers"
_PEER = "peer"


class BuildError(PqsecError):
    """The peer does not compile against what is installed."""


def built(installation: Installation) -> Path:
    """The program of a peer, compiled now unless it is in the user's cache.

    It is kept for the build of the library that it was linked to, and for no other. BuildError
    with the compiler's words if it does not compile, FileError if the disk refuses, or if others
    may write to the cache.
    """
    goal = cache() / f"{installation.build.stack}-{installation.version}-{_digest(installation)}"
    with disk_errors(goal):
        if not is_own(goal):
            with _workshop(installation) as folder:
                _compile(installation, folder)
                _refuse_another(installation, folder / _PEER)
                _keep(folder / _PEER, goal)
    return goal


def source(name: str) -> bytes:
    """A file that goes into a peer, or is its configuration."""
    return (_SOURCES / name).read_bytes()


def cache() -> Path:
    """Where programs are kept that were compiled for trials; FileError if others may write."""
    found = _named_cache()
    with disk_errors(found):
        for place in (found.parent, found):
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            _refuse_shared(place)
    return found


def _named_cache() -> Path:
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:  # a relative one is to be ignored, says the XDG Base Directory Specification
        home = named if named.is_absolute() else Path.home() / ".cache"
    except RuntimeError:
        hint = "set XDG_CACHE_HOME to a folder of yours"
        raise FileError("this user has no home, and so no cache", hint=hint) from None
    return home / "pqsec" / "peers"


def _refuse_shared(folder: Path) -> None:
    """What is in there will be run."""
    if not is_own(folder):
        raise FileError(
            f"{folder}: not of this user's alone, and no place for programs to run",
            hint="move it away, or set XDG_CACHE_HOME to a folder of yours",
        )


def is_own(path: Path) -> bool:
    """Whether it is there, no link, and nobody but this user may change it."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return False
    mine = found.st_uid == os.geteuid() and not stat.S_ISLNK(found.st_mode)
    return mine and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _digest(installation: Installation) -> str:
    """What else the program depends on."""
    places = (installation.root, installation.prefix, installation.folder)
    said = (*places, installation.library.build, installation.build.commands)
    parts = [repr(each).encode() for each in said]
    parts += map(source, installation.build.sources)
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


@contextmanager
def _workshop(installation: Installation) -> Iterator[Path]:
    """A folder with the sources, where the compiler can see it."""
    there = None if installation.root == MACHINE else installation.root / "tmp"
    with tempfile.TemporaryDirectory(prefix="pqsec-peer-", dir=there) as folder:
        for name in installation.build.sources:
            (Path(folder) / name).write_bytes(source(name))
        yield Path(folder)


def _compile(installation: Installation, folder: Path) -> None:
    place = f"/{folder.relative_to(installation.root)}"
    for command in installation.build.commands:
        name = command[0].rpartition("/")[2]
        code, said = _run(name, installation.tool(command, place))
        if code:
            lines = [line for line in said.splitlines() if "error" in line.lower()]
            words = (lines or said.splitlines() or ["it said nothing"])[0]
            raise BuildError(
                f"{name} cannot compile the peer for {installation.title}: {shown(words, 300)}",
                hint=f"is all of it installed? apt-get install {installation.build.packages}",
            )


def _refuse_another(installation: Installation, program: Path) -> None:
    """BuildError if the program was linked to another library than the one that it is for."""
    linked = read_library(program).needed
    if installation.soname not in linked:
        raise BuildError(
            f"the peer for {installation.title} is linked to {shown(', '.join(linked), 300)}, and"
            f" not to {shown(installation.soname)}",
            hint="is another version of it installed beside? take one of them away",
        )


def _run(name: str, command: list[str]) -> tuple[int, str]:
    """Its exit code and what it complained of; nothing that it started is left running."""
    with subprocess.Popen(  # noqa: S603 -- a row's command
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            said = process.communicate(timeout=PATIENCE)[1]
        except subprocess.TimeoutExpired:
            raise BuildError(f"{name} took more than {PATIENCE} seconds") from None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, said


def _keep(program: Path, goal: Path) -> None:
    """`program` at `goal`, whole or not at all."""
    handle, draft = tempfile.mkstemp(prefix=f".{goal.name}.", dir=goal.parent)
    os.close(handle)
    try:
        shutil.copyfile(program, draft)
        Path(draft).chmod(0o700)
        Path(draft).replace(goal)
    finally:
        Path(draft).unlink(missing_ok=True)
