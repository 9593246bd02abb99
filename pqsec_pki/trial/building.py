"""Compiles peers when they are first needed, and caches them."""

import fcntl
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
from pqsec_pki._places import make_folders, open_place
from pqsec_pki.errors import FileError, PqsecError, shown
from pqsec_pki.trial.installation import MACHINE, Installation
from pqsec_pki.vendors import read_library

PATIENCE = 300
"""Seconds for one command of a compiler."""
_SOURCES = Path(__file__).parent / "peers"
_PEER = "peer"


class BuildError(PqsecError):
    """The peer does not compile against what is installed."""


def built(installation: Installation) -> Path:
    """The program of a peer, compiled now unless it is in the user's cache.

    The cached program is used only with the build of the library that it was linked to.
    BuildError with the compiler's message if it does not compile; FileError for a disk error,
    or if others may write to the cache.
    """
    goal = cache() / f"{installation.build.stack}-{installation.version}-{_digest(installation)}"
    with disk_errors(goal), compiling_once(goal) as missing:
        if missing:
            with _build_folder(installation) as folder:
                _compile(installation, folder)
                _check_linked(installation, folder / _PEER)
                _install(folder / _PEER, goal)
    return goal


@contextmanager
def compiling_once(goal: Path) -> Iterator[bool]:
    """Whether `goal`, in the cache, is missing; another process that is compiling is waited for."""
    if is_own(goal):
        yield False
        return
    folder = os.open(goal.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield not is_own(goal)
    finally:
        os.close(folder)


def source(name: str) -> bytes:
    """A source file of a peer, or its configuration."""
    return (_SOURCES / name).read_bytes()


def cache() -> Path:
    """The folder of programs that were compiled for trials; FileError if others may write."""
    found = cache_path()
    with disk_errors(found):
        for place in (found.parent, found):
            make_folders(place, 0o700)
            _refuse_shared(place)
    return found


def cache_path() -> Path:
    """The folder of compiled programs, whether or not it exists; FileError without a home."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:  # the XDG Base Directory Specification says to ignore a relative path
        home = named if named.is_absolute() else Path.home() / ".cache"
    except RuntimeError:
        hint = "set XDG_CACHE_HOME to a folder of yours"
        raise FileError("this user has no home folder for the cache", hint=hint) from None
    return home / "pqsec" / "peers"


def _refuse_shared(folder: Path) -> None:
    """FileError if others may write to the folder: its programs will be run."""
    if not is_own(folder):
        raise FileError(
            f"{folder}: others may write here, so pqsec runs no programs from it",
            hint="move it away, or set XDG_CACHE_HOME to a folder of yours",
        )


def is_own(path: Path) -> bool:
    """Whether it exists, is not a link, and only this user may change it."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return False
    return not stat.S_ISLNK(found.st_mode) and open_place(path) is None


def _digest(installation: Installation) -> str:
    """A digest of everything else that the program depends on."""
    places = (installation.root, installation.prefix, installation.folder)
    inputs = (*places, installation.library.build, installation.build.commands)
    parts = [repr(each).encode() for each in inputs]
    parts += map(source, installation.build.sources)
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


@contextmanager
def _build_folder(installation: Installation) -> Iterator[Path]:
    """A temporary folder with the sources, below the installation's root."""
    there = None if installation.root == MACHINE else installation.root / "tmp"
    with tempfile.TemporaryDirectory(prefix="pqsec-peer-", dir=there) as folder:
        for name in installation.build.sources:
            (Path(folder) / name).write_bytes(source(name))
        yield Path(folder)


def _compile(installation: Installation, folder: Path) -> None:
    place = f"/{folder.relative_to(installation.root)}"
    for command in installation.build.commands:
        name = command[0].rpartition("/")[2]
        code, output = run_tool(name, installation.tool(command, place))
        if code:
            lines = [line for line in output.splitlines() if "error" in line.lower()]
            words = (lines or output.splitlines() or ["it printed nothing"])[0]
            raise BuildError(
                f"{name} cannot compile the peer for {installation.title}: {shown(words, 300)}",
                hint=f"install all packages: apt-get install {installation.build.packages}",
            )


def _check_linked(installation: Installation, program: Path) -> None:
    """BuildError if the program was linked to another library than the installation's."""
    linked = read_library(program).needed
    if installation.soname not in linked:
        raise BuildError(
            f"the peer for {installation.title} is linked to {shown(', '.join(linked), 300)}, and"
            f" not to {shown(installation.soname)}",
            hint="another version may be installed too: remove one of them",
        )


def run_tool(name: str, command: list[str]) -> tuple[int, str]:
    """The exit code and stderr of `command`; processes that it started are killed."""
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
            errors = process.communicate(timeout=PATIENCE)[1]
        except subprocess.TimeoutExpired:
            raise BuildError(f"{name} took more than {PATIENCE} seconds") from None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, errors


def _install(program: Path, goal: Path) -> None:
    """Copy `program` to `goal` atomically."""
    handle, draft = tempfile.mkstemp(prefix=f".{goal.name}.", dir=goal.parent)
    os.close(handle)
    try:
        shutil.copyfile(program, draft)
        Path(draft).chmod(0o700)
        Path(draft).replace(goal)
    finally:
        Path(draft).unlink(missing_ok=True)
