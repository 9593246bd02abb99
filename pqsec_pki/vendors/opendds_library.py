"""An OpenDDS on this machine: where its headers and libraries are.

OpenDDS is built by its users, and has no binary interface that holds between builds. So its folder
is named, by DDS_ROOT as in OpenDDS's own documents, and everything is found from there.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError, UsageError, shown
from pqsec_pki.vendors._symbols import read_symbols
from pqsec_pki.vendors.cyclone_plugins import in_words
from pqsec_pki.vendors.elf import Library, read_library
from pqsec_pki.vendors.exports import Version
from pqsec_pki.vendors.fastdds_library import AdapterError

VARIABLE = "DDS_ROOT"
SECURITY = "libOpenDDS_Security.so"
"""OpenDDS's own security plugins."""

_CORE = "libOpenDDS_Dcps.so"
_FACTORY = "_make_BuiltInPluginLoader"
"""What OpenDDS looks for in its library, unless ACE has a versioned name space."""
_WRITTEN, _GENERATED = "dds/DCPS/security/framework/SecurityRegistry.h", "dds/DdsSecurityCoreC.h"
_ACE, _TAO = "ace/Service_Object.h", "tao/LocalObject.h"
_PREFIX = "../.."
"""The prefix of an installed OpenDDS, whose DDS_ROOT is PREFIX/share/dds."""
_SCRIPTS = ("setenv.sh", "dds-devel.sh")
_SET = re.compile(r"(?m)^\s*(?:export\s+)?(ACE_ROOT|TAO_ROOT)=[\"']?([^\"'\n$]+)")
_VERSION = re.compile(r'(?m)^\s*#\s*define\s+DDS_VERSION\s+"(\d+(?:\.\d+){1,3})')
_BUILD = "build it with security first: `./configure --security` and `make` in its folder"


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenDds:
    """An OpenDDS that was built with security, and ACE and TAO."""

    root: Path
    library: Library
    """With its own security plugins."""
    version: Version
    """() if its headers do not have it."""
    include: tuple[Path, ...]
    """The folders of the headers."""
    libraries: tuple[Path, ...]
    """The folders of the libraries."""

    @property
    def title(self) -> str:
        """OpenDDS 3.13.3."""
        return f"OpenDDS {in_words(self.version)}"


def find_opendds(root: Path | None, environment: Mapping[str, str]) -> OpenDds:
    """The OpenDDS in `root`, by default $DDS_ROOT.

    UsageError without either, AdapterError with the reason if it cannot be compiled for; FileError
    and MalformedError if its library cannot be read, or is not one.
    """
    if root is None:
        if not environment.get(VARIABLE):
            raise UsageError(
                f"which OpenDDS is not known: {VARIABLE} is not set",
                hint="name the folder in which it was built: --root DIR",
            )
        root = Path(environment[VARIABLE])
    root = root.absolute()
    include = _with_headers(root)
    folder = _with_libraries(root)
    library = read_library(_files.resolved(folder / SECURITY))
    if _FACTORY not in read_symbols(library.path).exported:
        raise AdapterError(
            f"{library.path} does not export {_FACTORY}, by which OpenDDS loads plugins",
            hint="use an ACE without a versioned name space, and shared libraries",
        )
    below = _ace_and_tao(root, include, environment)
    return OpenDds(
        root=root,
        library=library,
        version=_version(include),
        include=_once([include, *below]),
        libraries=_once(
            each for each in (folder, *(one / "lib" for one in below)) if _files.is_there(each)
        ),
    )


def _with_headers(root: Path) -> Path:
    """AdapterError, with what is missing."""
    bases = [base for base in _bases(root) if _files.is_there(base / _WRITTEN)]
    if not bases:
        raise AdapterError(
            f"{shown(str(root))} has no headers of OpenDDS ({_WRITTEN})",
            hint=f"name the folder in which OpenDDS was built: --root DIR, or {VARIABLE}",
        )
    for base in bases:
        if _files.is_there(base / _GENERATED):
            return base
    raise AdapterError(f"{bases[0]} has no {_GENERATED}, which a build writes", hint=_BUILD)


def _with_libraries(root: Path) -> Path:
    """AdapterError, with what is missing."""
    folders = [base / name for base in _bases(root) for name in ("lib", "lib64")]
    for folder in folders:
        if _files.is_there(folder / SECURITY):
            return folder
    if any(_files.is_there(folder / _CORE) for folder in folders):
        raise AdapterError(
            f"the OpenDDS in {shown(str(root))} was built without security: it has no {SECURITY}",
            hint=_BUILD,
        )
    raise AdapterError(
        f"the OpenDDS in {shown(str(root))} is not built: it has no {_CORE}", hint=_BUILD
    )


def _ace_and_tao(root: Path, include: Path, environment: Mapping[str, str]) -> list[Path]:
    """Where ACE's headers are, and TAO's; AdapterError if they are not found."""
    said = {**_set_by_scripts(root), **{k: v for k, v in environment.items() if v}}
    ace = [Path(said["ACE_ROOT"])] if "ACE_ROOT" in said else []
    ace += [include, root / "ACE_wrappers", root / "../ACE_wrappers", root / "../ACE_TAO/ACE"]
    tao = [Path(said["TAO_ROOT"])] if "TAO_ROOT" in said else []
    tao += [include, *(each / "TAO" for each in ace), root / "../ACE_TAO/TAO"]
    found = []
    for name, places, header in (("ACE", ace, _ACE), ("TAO", tao, _TAO)):
        place = next((each for each in places if _files.is_there(each / header)), None)
        if place is None:
            raise AdapterError(
                f"the headers of {name} ({header}) are not in {shown(str(places[0]))}",
                hint=f"set {name}_ROOT to the folder in which {name} was built",
            )
        found.append(place)
    return found


def _set_by_scripts(root: Path) -> dict[str, str]:
    """The variables that OpenDDS's configure wrote down."""
    found: dict[str, str] = {}
    for name in _SCRIPTS:
        with suppress(PqsecError):
            text = _files.read(root / name).decode(errors="replace")
            found |= {key: value.strip() for key, value in _SET.findall(text)}
    return found


def _version(include: Path) -> Version:
    with suppress(PqsecError):
        text = _files.read(include / "dds/Version.h").decode(errors="replace")
        if found := _VERSION.search(text):
            return tuple(map(int, found[1].split(".")))
    return ()


def _bases(root: Path) -> Iterator[Path]:
    yield from (root, root / "include", root / _PREFIX, root / _PREFIX / "include")


def _once(paths: Iterable[Path]) -> tuple[Path, ...]:
    return tuple(dict.fromkeys(map(_files.resolved, paths)))
