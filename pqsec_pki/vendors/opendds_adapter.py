"""pqsec's plugin for OpenDDS: compiled against the user's own headers, for one build.

The adapter is one library: OpenDDS's classes in C++, and the C shim behind them. A program loads
it by a directive; for an unmodified program, a link to it in a folder of its own has the name of
OpenDDS's library, and is found first in LD_LIBRARY_PATH.
"""

import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin.building import SOURCES, CompileError, make_folder
from pqsec_pki.plugin.calls import VERSION
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors._symbols import read_symbols
from pqsec_pki.vendors.exports import Version
from pqsec_pki.vendors.fastdds_adapter import FLAGS, LINKED, Compilers
from pqsec_pki.vendors.opendds_library import SECURITY, OpenDds
from pqsec_pki.vendors.own_plugin import OPENDDS

OPENDDS_FACTORY = "_make_PqsecLoader"
FACTORIES = {OPENDDS_FACTORY, "_make_BuiltInPluginLoader"}
OPENDDS_LINK = Path(Stack.OPENDDS.value, SECURITY)
"""Below the folder of the plugin: its folder comes first in LD_LIBRARY_PATH."""
OPENDDS_RECORD = "pqsec-opendds.json"
OPENDDS_SOURCES = SOURCES.with_name(Stack.OPENDDS.value)

_STANDARDS = ("gnu++17", "gnu++14", "gnu++11")
"""Standards of C++: the first that the user's headers compile with counts; ACE 6 does not compile
with C++17."""
_DEFINED = (
    "-DOPENDDS_SECURITY",  # from 3.27 or so on, a header has it too
    "-D__ACE_INLINE__",  # then it does not matter how ACE was built
)
_LIBRARIES = ("OpenDDS_Dcps", "TAO_AnyTypeCode", "TAO", "ACE")
_PROBED = "stack.hpp"
"""Includes every header of OpenDDS that the adapter does, and uses what differs in versions."""


def compile_opendds(stack: OpenDds, folder: Path, compilers: Compilers) -> Path:
    """Compile the adapter into `folder`, an empty one; its path. CompileError if that fails."""
    for source in (*SOURCES.glob("*.[ch]"), *OPENDDS_SOURCES.iterdir()):
        if source.is_file():
            (folder / source.name).write_bytes(source.read_bytes())
    standard = _standard(stack, folder, compilers)
    for command in commands(stack, standard, compilers):
        compilers.run(command, folder)
    made = folder / OPENDDS
    missing = FACTORIES - read_symbols(made).exported
    if missing:
        raise CompileError(f"the compiled library lacks {', '.join(sorted(missing))}")
    return made


def commands(stack: OpenDds, standard: str, compilers: Compilers) -> Iterator[list[str]]:
    """The command lines that compile it, in a folder with the sources."""
    shim = sorted(path.name for path in SOURCES.glob("*.c"))
    status = stack.library.path.stat()
    yield [compilers.c, "-std=c11", *FLAGS, f'-DPQSEC_PYTHON="{sys.executable}"', "-c", *shim]
    yield [
        *_compiler(stack, standard, compilers),
        *LINKED,
        f'-DPQSEC_BUILTIN="{stack.library.path}"',
        f"-DPQSEC_BUILTIN_SIZE={status.st_size}",
        f"-DPQSEC_BUILTIN_TIME={int(status.st_mtime)}",
        *("-Wl,--version-script=exported.map", "-o", OPENDDS),
        *sorted(path.name for path in OPENDDS_SOURCES.glob("*.cpp")),
        *(name.replace(".c", ".o") for name in shim),
        *(f"-L{each}" for each in stack.libraries),
        *(f"-l{each}" for each in _LIBRARIES),
    ]


def _compiler(stack: OpenDds, standard: str, compilers: Compilers) -> list[str]:
    include = [word for each in stack.include for word in ("-isystem", str(each))]
    return [compilers.cxx, f"-std={standard}", *FLAGS, *_DEFINED, "-I.", *include]


def _standard(stack: OpenDds, folder: Path, compilers: Compilers) -> str:
    """The first that the headers compile with; CompileError, with the last one's words, if none."""

    def probe(standard: str) -> str:
        command = _compiler(stack, standard, compilers)
        compilers.run([*command, "-fsyntax-only", "-x", "c++", _PROBED], folder)
        return standard

    *others, last = _STANDARDS
    for each in others:
        with suppress(CompileError):
            return probe(each)
    return probe(last)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenDdsPlugin:
    """A plugin that was compiled, and the OpenDDS that it is for."""

    root: Path
    library: Path
    adapter: Path
    factory: str = OPENDDS_FACTORY
    """For the directive that loads the adapter."""
    first: Path
    """The folder of the link, for LD_LIBRARY_PATH."""

    def to_json(self) -> dict[str, object]:
        """The plugin for --json."""
        return asdict(self)


def install_opendds(
    stack: OpenDds, folder: Path, compilers: Compilers, *, force: bool = False
) -> OpenDdsPlugin:
    """Compile the adapter into `folder`, with its link and a record.

    ExistsError if one is installed that runs, unless `force`; CompileError if it cannot be
    compiled; FileError as make_folder.
    """
    found = installed_opendds(folder)
    if found and not found.problem and not force:
        _files.refuse_existing(folder / OPENDDS)
    _files.refuse_without_links(folder, "the plugin")
    with tempfile.TemporaryDirectory(prefix="pqsec-", dir=compilers.folder) as name:
        made = _files.read(compile_opendds(stack, Path(name), compilers))
    status = stack.library.path.stat()
    value = {
        "root": str(stack.root),
        "library": str(stack.library.path),
        "size": status.st_size,
        "time": int(status.st_mtime),
        "version": stack.version,
        "protocol": VERSION,
        "python": sys.executable,
    }
    link = folder / OPENDDS_LINK
    with _files.disk_errors(folder):
        make_folder(folder)
        make_folder(link.parent)
        _files.write(folder / OPENDDS, made, force=True)
        link.unlink(missing_ok=True)
        link.symlink_to(Path("..", OPENDDS))
        _files.write(folder / OPENDDS_RECORD, json.dumps(value).encode() + b"\n", force=True)
    return OpenDdsPlugin(
        root=stack.root,
        library=stack.library.path,
        adapter=folder / OPENDDS,
        first=link.parent,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class InstalledOpenDds:
    """An adapter that is installed, and the OpenDDS that it was compiled for."""

    folder: Path
    root: Path
    library: Path
    size: int
    time: int
    release: Version
    protocol: int
    """Version of the protocol that it speaks to the agent."""
    python: Path
    """The Python interpreter that starts the agent."""

    @property
    def problem(self) -> str:
        """Why it does not run in that OpenDDS; empty if it does."""
        try:
            found = self.library.stat()
        except (OSError, ValueError):  # a path that no file can have
            return f"{self.library} is gone"
        if (found.st_size, int(found.st_mtime)) != (self.size, self.time):
            return "OpenDDS was built again since"
        if self.protocol != VERSION:
            return "pqsec was updated since"
        if not (self.folder / OPENDDS).is_file() or not (self.folder / OPENDDS_LINK).is_file():
            return f"{OPENDDS} or the link to it is missing"
        return "" if self.python.is_file() else f"{self.python} is gone"


def installed_opendds(folder: Path) -> InstalledOpenDds | None:
    """The one in `folder`; None if there is none, or its record cannot be read."""
    with suppress(PqsecError, ValueError, KeyError, TypeError, RecursionError):
        value = json.loads(_files.read(folder / OPENDDS_RECORD))
        return InstalledOpenDds(
            folder=folder,
            root=Path(str(value["root"])),
            library=Path(str(value["library"])),
            size=int(value["size"]),
            time=int(value["time"]),
            release=tuple(int(number) for number in value["version"]),
            protocol=int(value["protocol"]),
            python=Path(str(value["python"])),
        )
    return None
