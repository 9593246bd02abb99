"""Finds the Fast DDS of this machine, and checks whether pqsec's plugin can run in it.

Fast DDS creates its plugins itself, as C++ objects. Another library of the process can create them
instead only if Fast DDS exports the functions that do, and calls them by name. The library's
symbols decide this, never its version.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, resolved
from pqsec_pki.errors import MissingError, PqsecError, UsageError, shown
from pqsec_pki.vendors._symbols import Symbols, read_symbols
from pqsec_pki.vendors.cyclone_plugins import in_words
from pqsec_pki.vendors.elf import Library, read_library, release_in, runs_here
from pqsec_pki.vendors.exports import Version
from pqsec_pki.vendors.fastdds_headers import FAST_CDR, FAST_DDS, Headers, Places, Project

MACHINE = Path("/")
NAMES = {2: "libfastrtps.so", 3: "libfastdds.so"}
PACKAGES = {2: "libfastrtps-dev", 3: "libfastdds-dev"}
FAST_CDR_LIBRARY = "libfastcdr.so"
"""The library whose headers those of Fast DDS need."""
PLUGINS = {"5PKIDH": "19PqsecAuthentication", "11Permissions": "18PqsecAccessControl"}
"""Fast DDS's own plugins and the adapter's, as C++ spells the names of classes."""

_SPACES = {2: "8eprosima8fastrtps4rtps", 3: "8eprosima7fastdds4rtps"}
_FACTORIES = ("28create_authentication_plugin", "28create_access_control_plugin")
_BY_PROPERTIES = "14PropertyPolicy"
_MORE_FUNCTIONS = "20get_participant_guid"
_ENDPOINTS = {
    "15WriterProxyData": "27PublicationBuiltinTopicData",
    "15ReaderProxyData": "28SubscriptionBuiltinTopicData",
}
"""What Fast DDS 3 knows of a discovered endpoint, and the public structure for it."""
_PLACES = (
    *("usr/local/lib", "usr/local/lib64", "usr/lib", "usr/lib64", "usr/lib/*-linux-gnu*"),
    *("opt/ros/*/lib", "opt/ros/*/lib/*-linux-gnu*"),
)
_WAY_OUT = "use a Fast DDS that is built as a shared library, without LTO and -Bsymbolic"
OTHER_VERSION = "use another version of Fast DDS, or report this one to pqsec's authors"


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
    derived: bool
    """Whether what it knows of an endpoint derives from a public structure (3.2)."""
    include: tuple[Path, ...]
    """The folders of its headers and of Fast CDR's, in the compiler's order."""
    libraries: tuple[Path, ...]
    """The folders of its library and of Fast CDR's."""
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


def examine(path: Path, root: Path = MACHINE, include: Iterable[Path] = ()) -> FastDds:
    """The Fast DDS at `path`, below `root`; folders in `include` are searched for headers first.

    AdapterError with the reason if pqsec's plugin cannot run in it, or headers are not there;
    FileError and MalformedError if it cannot be read, or is not a library. MissingError for a
    folder of `include` that is not there.
    """
    named = tuple(each.absolute() for each in include)
    for each in named:
        if not each.is_dir():
            raise MissingError(f"{each}: no such folder")
    library, generation, symbols = _recognised(path)
    _refuse_bound(path, generation, symbols)
    tables = tuple(symbols.tables.get(table_of(generation, name), ()) for name in PLUGINS)
    derived = _derived(path, generation, symbols)
    places = Places((path.absolute(), library.path), root, named)
    headers = _headers(places, FAST_DDS[generation], library.release, PACKAGES[generation])
    cdr, folder = _fast_cdr(places, library)
    return FastDds(
        library=library,
        root=root,
        generation=generation,
        version=max(library.release, headers.version, key=len),
        by_properties=any(_BY_PROPERTIES in name for slot in tables[0] for name in slot),
        more_functions=any(_MORE_FUNCTIONS in name for slot in tables[0] for name in slot),
        derived=derived,
        include=tuple(dict.fromkeys((*named, *headers.folders, *cdr.folders))),
        libraries=tuple(dict.fromkeys((library.path.parent, *folder))),
        tables=tables,
    )


def _recognised(path: Path) -> tuple[Library, int, Symbols]:
    """The library, the generation of its classes, and its symbols; AdapterError if it is not Fast
    DDS for this machine, with security and a build ID."""
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
    return library, generation, symbols


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


def _derived(path: Path, generation: int, symbols: Symbols) -> bool:
    """Whether Fast DDS 3 gives a discovered endpoint as what derives from its public structure;
    before 3.2 it exports a function that converts. AdapterError if it does neither."""
    space = f"_ZN{_SPACES[generation]}"
    converting = {
        f"{space}21from_proxy_to_builtinERKNS1_{own}ERNS1_{public}E"
        for own, public in _ENDPOINTS.items()
    }
    reading = {f"{space}{own}21read_from_cdr_messageE" for own in _ENDPOINTS}
    if generation == 2 or converting <= symbols.exported:  # noqa: PLR2004 -- its headers have them
        return False
    if all(any(name.startswith(each) for name in symbols.exported) for each in reading):
        return True
    raise AdapterError(
        f"{shown(str(path))} describes discovered endpoints in a way that pqsec does not know",
        hint=OTHER_VERSION,
    )


def _fast_cdr(places: Places, library: Library) -> tuple[Headers, list[Path]]:
    """The headers of the Fast CDR that the library loads, and the folder of that Fast CDR."""
    name = next((each for each in library.needed if each.startswith(FAST_CDR_LIBRARY)), "")
    headers = _headers(places, FAST_CDR, release_in(name), "libfastcdr-dev")
    folder = places.folder_of(name, FAST_CDR, headers) if name else None
    return headers, [folder] if folder else []


def _headers(places: Places, project: Project, release: Version, package: str) -> Headers:
    """The headers of that project; AdapterError if they are not there."""
    found = places.headers(project, release)
    if found.folders:
        return found
    other = f"only headers of {in_words(found.version)} are there"
    words = other if found.version else "they are not there"
    raise AdapterError(
        f"the adapter for {shown(str(places.links[-1]))} is compiled with the headers of"
        f" {project.title}, and {words}",
        hint=f"install them: apt-get install {package}, or those of ROS 2; or name the folder that"
        f" has {project.header}: --include DIR",
    )
