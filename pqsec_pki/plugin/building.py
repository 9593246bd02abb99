"""Compiles the shim, and tests it."""

import os
import sys
from pathlib import Path
from typing import Self

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki._places import make_folders, refuse_outsiders
from pqsec_pki.errors import PqsecError, shown
from pqsec_pki.plugin.units import planned_units, write_units

LIBRARY = "libpqsec_dds.so"
NAMES = ("libdds_security_auth.so", "libdds_security_ac.so")
"""The names that ROS 2 always loads: links to the library, first in the search path."""
SOURCES = Path(__file__).with_name("shim")
_FLAGS = (
    *("-std=c11", "-O2", "-fPIC", "-shared", "-pthread", "-fvisibility=hidden"),
    *("-fstack-protector-strong", "-D_FORTIFY_SOURCE=2"),
    # It stays in memory: a thread may still run in it when Cyclone DDS unloads it.
    *("-Wl,-z,nodelete", "-Wl,-z,now", "-Wl,-z,relro"),
)
_FUNCTIONS = tuple(
    f"{verb}_{plugin}"
    for plugin in ("authentication", "access_control")
    for verb in ("init", "finalize")
)
_FAULTS = ("error", "undefined reference", "cannot find", "no such file")
"""In the lines of GCC, Clang and their linkers that say what is wrong, in English."""
_MOST_LINES, _MOST_WORDS = 5, 1500
_SECONDS = 120
_MODE = 0o755
"""The mode of the folder: others may load the plugin from it."""


class CompileError(PqsecError):
    """The shim cannot be compiled, or the compiled library does not work."""

    output: str | None = None
    """What a command that failed wrote of errors, on one line; None if it was not run."""

    @classmethod
    def of(cls, stderr: str, *, hint: str | None = None) -> Self:
        """The error of a compiler or linker that failed."""
        lines = [" ".join(line.split()) for line in stderr.splitlines()]
        faults = [line for line in lines if any(word in line.lower() for word in _FAULTS)]
        output = "; ".join((faults or [line for line in lines if line])[:_MOST_LINES])
        error = cls(f"the compiler says: {shown(output, _MOST_WORDS) or 'nothing'}", hint=hint)
        error.output = output
        return error


@dataclass(frozen=True, slots=True)
class Built:
    """A shim that was compiled and tested."""

    library: Path
    links: tuple[Path, ...]
    units: tuple[Path, ...] = ()
    """The units of systemd, if they were wanted."""

    def to_json(self) -> dict[str, object]:
        """The files for --json."""
        units = {"units": self.units} if self.units else {}
        return {"library": self.library, "links": self.links, **units}


def build(folder: Path, *, units: Path | None = None, force: bool = False) -> Built:
    """Compile the shim into `folder`, with the links that ROS 2 needs.

    With `units`, systemd's go into that folder.

    CompileError, with the compiler's words, if that fails; ExistsError for files that are
    there already, unless `force`; FileError as make_folder.
    """
    library, links = folder / LIBRARY, tuple(folder / name for name in NAMES)
    if not force:
        for path in (library, *links):
            _files.refuse_existing(path)
    _files.refuse_without_links(folder, "the plugin")
    planned = planned_units(units, force=force) if units else {}
    compiled = _compiled()
    try:
        make_folder(folder)
        _files.write(library, compiled, force=force)
        for link in links:
            link.unlink(missing_ok=True)
            link.symlink_to(LIBRARY)
    except OSError as error:
        raise CompileError(f"{folder}: {(error.strerror or '').lower()}") from error
    write_units(planned)
    return Built(library, links, tuple(planned))


def make_folder(folder: Path) -> None:
    """Make the folder of the plugin if it is missing; OSError if that fails.

    FileError if another user, other than root, could change it or a folder above it.
    """
    words = "anyone who may write there can change what DDS processes load"
    refuse_outsiders([folder], words, roots=True)
    make_folders(folder, _MODE)
    refuse_outsiders([folder], words, roots=True)


def compiler() -> str:
    """The command of the C compiler; CompileError if there is none."""
    import shutil  # noqa: PLC0415 -- not for the agent, which starts with this room

    found = shutil.which(os.environ.get("CC") or "cc")
    if found is None:
        raise CompileError("there is no C compiler", hint="install one: apt-get install gcc")
    return found


def command(cc: str, output: Path, *more: str) -> list[str]:
    """The compiler's command for the shim, with this interpreter for the agent."""
    python = f'-DPQSEC_PYTHON="{sys.executable}"'
    sources = sorted(map(str, SOURCES.glob("*.c")))
    return [cc, *_FLAGS, python, *more, "-o", str(output), *sources]


def _compiled() -> bytes:
    import subprocess  # noqa: PLC0415 -- as above
    import tempfile  # noqa: PLC0415 -- as above

    with tempfile.TemporaryDirectory(prefix="pqsec-") as folder:
        output = Path(folder, LIBRARY)
        try:
            done = subprocess.run(  # noqa: S603 -- the user's own compiler
                command(compiler(), output),
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_SECONDS,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CompileError(f"the compiler cannot be run: {error}") from error
        if done.returncode != 0:
            raise CompileError.of(
                done.stderr,
                hint="install a C compiler and its headers: apt-get install gcc libc6-dev",
            )
        _try_out(output)
        return _files.read(output)


def _try_out(library: Path) -> None:
    """CompileError unless it loads, and has the functions that Cyclone DDS calls."""
    import ctypes  # noqa: PLC0415 -- as above

    try:
        loaded = ctypes.CDLL(str(library))
    except OSError as error:
        raise CompileError(f"the compiled library cannot be loaded: {error}") from error
    missing = [name for name in _FUNCTIONS if not hasattr(loaded, name)]
    if missing:
        raise CompileError(f"the compiled library lacks {', '.join(missing)}")
