"""Finds the Fast DDS of this machine, and checks whether pqsec's plugin can run in it.

Fast DDS creates its plugins itself, as C++ objects. Another library of the process can create them
instead only if Fast DDS exports the functions that do, and calls them by name. The library's
symbols decide this, never its version.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, resolved
from pqsec_pki.errors import PqsecError, UsageError, shown
from pqsec_pki.vendors._symbols import Symbols, read_symbols
from pqsec_pki.vendors.cyclone_plugins import agree, in_words
from pqsec_pki.vendors.elf import Library, read_library, runs_here
from pqsec_pki.vendors.exports import Version

MACHINE = Path("/")
NAMES = {2: "libfastrtps.so", 3: "libfastdds.so"}
PACKAGES = {2: "libfastrtps-dev", 3: "libfastdds-dev"}
PLUGINS = {"5PKIDH": "19PqsecAuthentication", "11Permissions": "18PqsecAccessControl"}
"""Fast DDS's own plugins and the adapter's, as C++ spells the names of classes."""

_SPACES = {2: "8eprosima8fastrtps4rtps", 3: "8eprosima7fastdds4rtps"}
_FACTORIES = ("28create_authentication_plugin", "28create_access_control_plugin")
_BY_PROPERTIES = "14PropertyPolicy"
_MORE_FUNCTIONS = "20get_participant_guid"
_PLACES = (
    *("usr/local/lib", "usr/local/lib64", "usr/lib", "usr/lib64", "usr/lib/*-linux-gnu*"),
    *("opt/ros/*/lib", "opt/ros/*/lib/*-linux-gnu*"),
)
_HEADERS = {2: ("fastrtps/config.h", "FASTRTPS"), 3: ("fastdds/config.hpp", "FASTDDS")}
_WAY_OUT = "use a Fast DDS that is built as a shared library, without LTO and -Bsymbolic"


class AdapterError(PqsecError):
    """pqsec's plugin cannot be made to run in that library."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FastDds:
    """A library of Fast DDS that pqsec's plugin can run in, with its headers."""

    library: Library
    root: Path
    """The root file system that it is in."""
    generation: int
    """2 or 3: the name space of its classes."""
    version: Version
    """The version, as far as names and headers show it."""
    by_properties: bool
    """Whether its plugins get the properties of a participant as a PropertyPolicy."""
    more_functions: bool
    """Whether its authentication plugin has two more functions (2.6.12, 3.2.5)."""
    include: Path
    """The folder of its headers."""
    tables: tuple[tuple[frozenset[str], ...], ...]
    """The virtual functions of its own plugins, in the order of PLUGINS."""

    @property
    def title(self) -> str:
        """Fast DDS 2.9.1."""
        return f"Fast DDS {in_words(self.version)}"

    def seen(self, path: Path) -> str:
        """`path` as processes in its root file system see it."""
        return f"/{path.relative_to(self.root)}"


def table_of(generation: int, name: str) -> str:
    """The symbol of the virtual functions of a security plugin's class."""
    return f"_ZTVN{_SPACES[generation]}8security{name}E"


def find_fastdds(root: Path = MACHINE) -> Path:
    """The one Fast DDS below `root`; AdapterError if there is none, UsageError if several."""
    with disk_errors(root):
        found = {resolved(each) for name in NAMES.values() for each in _named(root, name)}
    if not found:
        raise AdapterError(
            "Fast DDS is not installed in a usual place",
            hint="name its library: --library PATH",
        )
    if len(found) > 1:
        words = ", ".join(sorted(map(str, found)))
        raise UsageError(f"there are several Fast DDS: {words}", hint="choose with --library PATH")
    return found.pop()


def _named(root: Path, name: str) -> Iterator[Path]:
    for place in _PLACES:
        yield from (each for each in root.glob(f"{place}/{name}*") if each.is_file())


def examine(path: Path, root: Path = MACHINE) -> FastDds:
    """The Fast DDS at `path`, below `root`.

    AdapterError with the reason if pqsec's plugin cannot run in it, or its headers are not there;
    FileError and MalformedError if it cannot be read, or is not a library.
    """
    library = read_library(path)
    if not runs_here(library):
        raise AdapterError(f"{shown(str(path))} is for another processor than this machine's")
    names = {table_of(each, name) for each in _SPACES for name in PLUGINS}
    symbols = read_symbols(path, names)
    generation = next((each for each in _SPACES if _factories(each) <= symbols.exported), None)
    if generation is None:
        raise AdapterError(
            f"{shown(str(path))} does not export the functions that make security plugins:"
            " it is not Fast DDS, or was built without security",
            hint="use a Fast DDS that was built with -DSECURITY=ON",
        )
    if not library.build_id:
        raise AdapterError(
            f"{shown(str(path))} has no build ID, by which pqsec's plugin recognises it",
            hint="link Fast DDS with -Wl,--build-id",
        )
    _refuse_bound(path, generation, symbols)
    tables = tuple(symbols.tables.get(table_of(generation, name), ()) for name in PLUGINS)
    include, headers = _headers(library, generation, root)
    return FastDds(
        library=library,
        root=root,
        generation=generation,
        version=max(library.release, headers, key=len),
        by_properties=any(_BY_PROPERTIES in name for slot in tables[0] for name in slot),
        more_functions=any(_MORE_FUNCTIONS in name for slot in tables[0] for name in slot),
        include=include,
        tables=tables,
    )


def _factories(generation: int) -> frozenset[str]:
    return frozenset(
        f"_ZN{_SPACES[generation]}8security21SecurityPluginFactory{name}ERKNS1_14PropertyPolicyE"
        for name in _FACTORIES
    )


def _refuse_bound(path: Path, generation: int, symbols: Symbols) -> None:
    """AdapterError unless another definition of the factories counts, and all slots have names."""
    reached = symbols.called | symbols.pointed
    if symbols.is_symbolic or not _factories(generation) <= reached:
        raise AdapterError(
            f"{shown(str(path))} calls the functions that make its security plugins directly:"
            " they cannot be replaced",
            hint=_WAY_OUT,
        )
    for name in PLUGINS:
        slots = symbols.tables.get(table_of(generation, name), ())
        if len(slots) < 3 or not all(slots[2:]):  # noqa: PLR2004 -- the first two are destructors
            raise AdapterError(
                f"{shown(str(path))} hides the names of its plugins' functions, so pqsec"
                " cannot check whether its own fit",
                hint="use a Fast DDS that exports its symbols, as packages do",
            )


def _headers(library: Library, generation: int, root: Path) -> tuple[Path, Version]:
    """The folder of the library's headers, and their version."""
    header, macro = _HEADERS[generation]
    version = re.compile(rf'#define {macro}_VERSION_STR "([0-9]{{1,4}}(?:\.[0-9]{{1,4}}){{0,3}})"')
    found: Version = ()
    for above in library.path.parents:
        if not above.is_relative_to(root):
            break
        include = above / "include"
        for path in (include / header, *sorted(include.glob(f"*-linux-gnu*/{header}"))):
            text = path.read_text(errors="replace") if path.is_file() else ""
            if match := version.search(text):
                found = tuple(map(int, match[1].split(".")))
                if agree(found, library.release):
                    return include, found
    words = f"only headers of {in_words(found)} are there" if found else "its headers are not there"
    raise AdapterError(
        f"the adapter for {shown(str(library.path))} is compiled with its headers, and {words}",
        hint=f"install them: apt-get install {PACKAGES[generation]}, or those of ROS 2",
    )
