"""pqsec's plugin for Fast DDS: compiled for one build of the library, and compared with it.

The preload library (C) replaces the functions with which Fast DDS creates its plugins. It opens the
adapter (C++) that has the build ID of the calling library in its name. So another build of Fast DDS
does not get a plugin that was made for this one.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from os import environ
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError, shown
from pqsec_pki.plugin.building import SOURCES, CompileError, compiler, make_folder
from pqsec_pki.plugin.calls import VERSION
from pqsec_pki.vendors._symbols import read_symbols
from pqsec_pki.vendors.elf import read_library
from pqsec_pki.vendors.exports import Version
from pqsec_pki.vendors.fastdds_library import (
    FAST_CDR_LIBRARY,
    OTHER_VERSION,
    PLUGINS,
    AdapterError,
    FastDds,
    table_of,
)
from pqsec_pki.vendors.own_plugin import PRELOAD

ADAPTER, RECORD = "pqsec-fastdds-{}.so", "pqsec-fastdds-{}.json"
"""Files of an adapter, named by the build ID of the library that it is for."""
FASTDDS_SOURCES = SOURCES.with_name("fastdds")

_SHIM = ("wire.c", "frames.c", "link.c", "agent.c", "watch.c")
_ADAPTER = "adapter.cpp"
_PROBE = "probe_run"
_ONE_BUILD = "name headers and library of one build: --include DIR, --library PATH"
FLAGS = (
    *("-O2", "-fPIC", "-pthread", "-fvisibility=hidden", "-fstack-protector-strong"),
    *("-U_FORTIFY_SOURCE", "-D_FORTIFY_SOURCE=2"),
)
LINKED = ("-shared", "-Wl,-z,relro", "-Wl,-z,now", "-Wl,-z,defs", "-Wl,-z,nodelete")
"""For every adapter, in C and C++, as the line before."""
_SECONDS = 300
_DESTRUCTORS = 2

Run = Callable[[Sequence[str], Path], None]
"""Runs a compiler's command in a folder; CompileError with its message if it fails."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compilers:
    """Commands, and how to run them."""

    c: str
    cxx: str
    run: Run
    folder: Path | None = None
    """The folder below which they see files of this process; None for everywhere."""


def here() -> Compilers:
    """The compilers of this machine; CompileError if there are none."""
    cxx = shutil.which(environ.get("CXX") or "c++")
    if cxx is None:
        raise CompileError("there is no C++ compiler", hint="install one: apt-get install g++")
    return Compilers(c=compiler(), cxx=cxx, run=_run)


def compile_adapter(stack: FastDds, folder: Path, compilers: Compilers) -> None:
    """Compile both libraries into `folder`, an empty one that the compilers can see.

    CompileError if that fails, AdapterError if the adapter's functions are not those that the
    library calls.
    """
    for source in sources():
        (folder / source.name).write_bytes(source.read_bytes())
    try:
        for command in commands(stack, compilers):
            compilers.run(command, folder)
    except CompileError as error:
        error.hint = _ONE_BUILD
        raise
    _refuse_unlike(stack, folder / ADAPTER.format(stack.library.build))


def probe(stack: FastDds, folder: Path, compilers: Compilers) -> None:
    """Let the library describe an endpoint to the adapter that was compiled into `folder`.

    AdapterError if the adapter does not find in it what the library put there. Names of functions
    do not show this, and neither do versions.
    """
    build, run = probe_commands(stack, compilers)
    compilers.run(build, folder)
    try:
        compilers.run(run, folder)
    except CompileError as error:
        if error.output is None:
            raise
        raise AdapterError(
            f"pqsec's plugin does not find the topics of endpoints in {stack.title}, with the"
            f" headers in {stack.include[0]}: {shown(error.output, 500) or 'the probe crashed'}",
            hint=f"{_ONE_BUILD}; or {OTHER_VERSION}",
        ) from error


def sources() -> list[Path]:
    """All that is compiled."""
    shim = [path for path in SOURCES.glob("*.h") if path.is_file()]
    return sorted([*shim, *(SOURCES / name for name in _SHIM), *FASTDDS_SOURCES.glob("*.[ch]*")])


def commands(stack: FastDds, compilers: Compilers) -> Iterator[list[str]]:
    """The commands that compile them, in a folder with the sources."""
    build = stack.library.build
    python = f'-DPQSEC_PYTHON="{sys.executable}"'
    yield [compilers.c, "-std=c11", *FLAGS, python, "-c", *_SHIM]
    yield [
        *(compilers.cxx, "-std=c++17", "-fno-ipa-icf", *FLAGS, *LINKED),
        *(f"-DPQSEC_FASTDDS={stack.generation}", f'-DPQSEC_BUILD_ID="{build}"'),
        *(["-DPQSEC_BY_PROPERTIES=1"] if stack.by_properties else []),
        *(["-DPQSEC_MORE_FUNCTIONS=1"] if stack.more_functions else []),
        *(["-DPQSEC_DERIVED=1"] if stack.derived else []),
        *("-I.", *(f"-I{stack.seen(each)}" for each in stack.include)),
        *("-o", ADAPTER.format(build), _ADAPTER, *(name.replace(".c", ".o") for name in _SHIM)),
        *_libraries(stack),
    ]
    yield [compilers.c, "-std=c11", *FLAGS, *LINKED, "-o", PRELOAD, "preload.c", "-ldl"]


def probe_commands(stack: FastDds, compilers: Compilers) -> tuple[list[str], list[str]]:
    """What compiles the probe, where the adapter was compiled; and what runs it."""
    adapter = f"./{ADAPTER.format(stack.library.build)}"
    # DT_RPATH, which counts for the libraries of libraries too: nothing is in LD_LIBRARY_PATH.
    paths = [f"-Wl,-rpath,{stack.seen(each)}" for each in stack.libraries]
    words = [compilers.c, "-std=c11", "-o", _PROBE, f"{_PROBE}.c", adapter, *_libraries(stack)]
    return [*words, "-Wl,--disable-new-dtags", *paths], [f"./{_PROBE}"]


def _libraries(stack: FastDds) -> Iterator[str]:
    """For the linker: the library, and exactly the Fast CDR that it loads."""
    yield stack.seen(stack.library.path)
    yield from (f"-L{stack.seen(each)}" for each in stack.libraries)
    yield from (f"-l:{each}" for each in stack.library.needed if each.startswith(FAST_CDR_LIBRARY))


def _run(command: Sequence[str], folder: Path) -> None:
    try:
        done = subprocess.run(  # noqa: S603 -- the user's own compiler
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CompileError(f"{command[0]} cannot be run: {error}") from error
    if done.returncode != 0:
        raise CompileError.of(done.stderr)


def _refuse_unlike(stack: FastDds, adapter: Path) -> None:
    """AdapterError unless the slots of the adapter's classes have the library's names and types."""
    tables = {own: table_of(stack.generation, own) for own in PLUGINS.values()}
    found = read_symbols(adapter, tables.values()).tables
    for (theirs, own), slots in zip(PLUGINS.items(), stack.tables, strict=True):
        ours = found.get(tables[own], ())
        alike = [
            {each.replace(theirs, own, 1) for each in one} & other
            for one, other in zip(slots, ours, strict=False)
        ]
        if len(slots) != len(ours) or not all(alike[_DESTRUCTORS:]):
            raise AdapterError(
                f"the functions of {stack.title}'s plugins are not those that pqsec knows"
                f" ({theirs.lstrip('0123456789')}: {len(slots)}, pqsec's: {len(ours)})",
                hint=OTHER_VERSION,
            )


@dataclass(frozen=True, slots=True)
class FastDdsPlugin:
    """A plugin that was compiled, and the library that it is for."""

    library: Path
    build: str
    """The build ID of the library."""
    preload: Path
    """For LD_PRELOAD."""

    def to_json(self) -> dict[str, object]:
        """The plugin for --json."""
        return asdict(self)


def install(
    stack: FastDds, folder: Path, compilers: Compilers, *, force: bool = False
) -> FastDdsPlugin:
    """Compile both into `folder`, with a record of the library.

    An adapter for an earlier build at the same path is removed. ExistsError if a working adapter
    for this build is installed, unless `force`; other errors as of compile_adapter and probe.
    """
    adapter, record = (folder / name.format(stack.library.build) for name in (ADAPTER, RECORD))
    runs = [each.build for each in installed(folder) if not each.problem]
    if not force and stack.library.build in runs:
        _files.refuse_existing(adapter)
    with tempfile.TemporaryDirectory(prefix="pqsec-", dir=compilers.folder) as name:
        compile_adapter(stack, Path(name), compilers)
        probe(stack, Path(name), compilers)
        made = {path: _files.read(Path(name, path)) for path in (PRELOAD, adapter.name)}
    value = {
        "library": str(stack.library.path),
        "build": stack.library.build,
        "version": stack.version,
        "protocol": VERSION,
        "python": sys.executable,
    }
    with _files.disk_errors(folder):
        make_folder(folder)
        _files.write(folder / PRELOAD, made[PRELOAD], force=True)
        _files.write(adapter, made[adapter.name], force=True)
        _files.write(record, json.dumps(value).encode() + b"\n", force=True)
        for each in installed(folder):
            if each.library == stack.library.path and each.build != stack.library.build:
                for name in (ADAPTER, RECORD):
                    (folder / name.format(each.build)).unlink(missing_ok=True)
    return FastDdsPlugin(stack.library.path, stack.library.build, folder / PRELOAD)


@dataclass(frozen=True, slots=True, kw_only=True)
class InstalledAdapter:
    """An adapter that is installed, and the library that it was compiled for."""

    library: Path
    build: str
    release: Version
    protocol: int
    """Version of its protocol with the agent."""
    python: Path
    """The Python that starts the agent."""

    @property
    def problem(self) -> str:
        """Why it does not run in the library at that path; empty if it does."""
        try:
            build = read_library(self.library).build
        except (PqsecError, ValueError) as error:  # a path that no file can have
            return str(error)
        if build != self.build:
            return "the library was updated since"
        if self.protocol != VERSION:
            return "pqsec was updated since"
        return "" if self.python.is_file() else f"{self.python} is gone"


def installed(folder: Path) -> list[InstalledAdapter]:
    """The adapters in `folder`; one whose record cannot be read is left out."""
    found = []
    for path in sorted(folder.glob(RECORD.format("*"))):
        with suppress(PqsecError, ValueError, KeyError, TypeError, RecursionError):
            value = json.loads(_files.read(path))
            build, library = str(value["build"]), Path(str(value["library"]))
            if path.name == RECORD.format(build) and (folder / ADAPTER.format(build)).is_file():
                release = tuple(int(number) for number in value["version"])
                found.append(
                    InstalledAdapter(
                        library=library,
                        build=build,
                        release=release,
                        protocol=int(value["protocol"]),
                        python=Path(str(value["python"])),
                    )
                )
    return found
