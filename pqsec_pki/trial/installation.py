"""Finds a stack that is installed on this machine, or in another root file system.

Headers, library, tools and plugins must come from one prefix. A compiler with its default paths
may combine the headers in /usr/local with the library in /usr, and mix two versions.
"""

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki.errors import PqsecError, UsageError, shown
from pqsec_pki.trial.peer_builds import PEER_BUILDS, STACKS, Command, PeerBuild
from pqsec_pki.vendors import Library, agree, in_words, read_library, runs_here

MACHINE = Path("/")
PREFIXES = ("usr/local", "usr")
"""In the order in which a compiler searches for headers."""
_FOLDERS = ("lib", "lib64", "lib/*-linux-gnu*")
_UNFIT = ":;$"
"""Characters in a folder's name that are special for the loader (ld.so(8))."""


class MissingStackError(PqsecError):
    """A stack, or a tool that compiles its peers, is not installed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Installation:
    """One version of a stack, with its headers and libraries below `root`."""

    build: PeerBuild
    version: str
    """The version of the library that peers are linked to and run with."""
    root: Path
    prefix: str
    """Below the root, one of PREFIXES."""
    folder: Path
    """The folder of the library."""
    library: Library

    @property
    def title(self) -> str:
        """Name and version: `Cyclone DDS 0.10.2`."""
        return f"{self.build.stack.product} {self.version}"

    @property
    def soname(self) -> str:
        """The name by which the library is loaded."""
        return self.library.soname or self.build.library

    @property
    def plugins(self) -> Path | None:
        """The folder of this library's security plugins, if the stack needs it."""
        return self.build.plugins(self.root, self.library.path) if self.build.plugins else None

    def tool(self, command: Command, folder: str) -> list[str]:
        """The command line that runs a compiler's `command` in `folder`, a path below the root."""
        line = ["env", "-C", folder, *map(self._filled, command)]
        if self.root == MACHINE:
            return line
        become_root = [] if os.geteuid() == 0 else ["unshare", "-r"]
        return [*become_root, "chroot", str(self.root), *line]

    def peer(self, program: Path) -> list[str]:
        """The command line of a compiled `program`; in another root, with that root's libraries."""
        if self.root == MACHINE:
            return [str(program)]
        loaders = sorted(self.root.glob("usr/lib/*-linux-gnu*/ld-linux*.so.*"))
        if not loaders:
            raise MissingStackError(
                f"{self.root} has no program loader: usr/lib/*/ld-linux*",
                hint="give --root the root file system of a Debian or Ubuntu",
            )
        places = dict.fromkeys([self.folder, *self._folders(), loaders[0].parent])
        return [str(loaders[0]), "--library-path", ":".join(map(str, places)), str(program)]

    def _filled(self, word: str) -> str:
        """A word of a command, with this installation's paths filled in."""
        places = {
            "{bin}": f"/{self.prefix}/bin",
            "{include}": f"/{self.prefix}/include",
            "{lib}": f"/{self.folder.relative_to(self.root)}",
            "{run}": str(self.folder),
        }
        for name, place in places.items():
            word = word.replace(name, place)
        return word

    def _folders(self) -> Iterator[Path]:
        """The other folders below the root that the loader searches."""
        for prefix in PREFIXES:
            yield from folders_of_libraries(self.root / prefix)


def folders_of_libraries(prefix: Path) -> Iterator[Path]:
    """The library folders that exist below `prefix`."""
    for pattern in _FOLDERS:
        yield from (each for each in sorted(prefix.glob(pattern)) if each.is_dir())


def find(stack: str, root: Path = MACHINE) -> Installation:
    """Find the stack below `root` whose headers a compiler would use.

    UsageError for a stack that cannot be tried. MissingStackError, naming the packages, if it is
    not installed, cannot be compiled against, or its headers, library and plugins have
    different versions.
    """
    if stack not in STACKS:
        raise UsageError(f"{stack!r} cannot be tried", hint=f"these can: {', '.join(STACKS)}")
    root = root.absolute()
    if unfit := sorted(set(_UNFIT) & set(str(root))):
        raise UsageError(
            f"{shown(str(root))}: the loader cannot use a folder with {unfit[0]!r} in its name"
        )
    peer_builds = [build for build in PEER_BUILDS if build.stack == stack]
    with disk_errors(root):
        headers = next(_headers(peer_builds, root), None)
        if headers is None:
            raise MissingStackError(
                f"{peer_builds[0].stack.product} is not installed with its headers below {root}",
                hint=" or: ".join(
                    f"apt-get install {build.packages}" for build in reversed(peer_builds)
                ),
            )
        found = _with_library(*headers, root)
        _refuse_missing_tools(found)
    return found


def _headers(peer_builds: list[PeerBuild], root: Path) -> Iterator[tuple[PeerBuild, str, str]]:
    """(build, version, prefix) of each set of headers, in a compiler's search order."""
    for prefix in PREFIXES:
        for build in peer_builds:
            version = re.compile(
                rf'#define {build.macro} "([0-9]{{1,4}}(?:\.[0-9]{{1,4}}){{0,3}})"'
            )
            folder = root / prefix / "include"
            for path in [
                folder / build.header,
                *sorted(folder.glob(f"*-linux-gnu*/{build.header}")),
            ]:
                text = path.read_text(errors="replace") if path.is_file() else ""
                if match := version.search(text):
                    yield build, match[1], prefix


def _with_library(build: PeerBuild, version: str, prefix: str, root: Path) -> Installation:
    """The installation with the library of that prefix; MissingStackError if versions differ."""
    headers = f"the headers of {build.stack.product} {version} are in {root / prefix / 'include'}"
    hint = f"install all packages of one version there, or remove the headers: {build.packages}"
    found_in = next(_libraries(build, root / prefix), None)
    if found_in is None:
        raise MissingStackError(
            f"{headers}, but {build.library} is not in {root / prefix / 'lib'}", hint=hint
        )
    folder, library = found_in
    release = tuple(map(int, version.split(".")))
    if not agree(release, library.release):
        raise MissingStackError(
            f"{headers}, but {library.path} has version {in_words(library.release)}", hint=hint
        )
    if library.soname and (folder / library.soname).resolve() != library.path:
        raise MissingStackError(
            f"{folder / shown(library.soname)}, which programs load, is not {library.path}",
            hint=f"`ldconfig -n {folder}` creates the link",
        )
    found = Installation(
        build=build,
        version=in_words(max(library.release, release, key=len)),
        root=root,
        prefix=prefix,
        folder=folder,
        library=library,
    )
    if build.plugins and found.plugins is None:
        raise MissingStackError(
            f"{found.title} in {folder} has no security plugins",
            hint="install its plugins there: they are built with ENABLE_SECURITY",
        )
    return found


def _libraries(build: PeerBuild, prefix: Path) -> Iterator[tuple[Path, Library]]:
    """(folder, library) of the libraries below `prefix` that a peer can load."""
    for folder in folders_of_libraries(prefix):
        if (folder / build.library).is_file():
            library = read_library(folder / build.library)
            if runs_here(library):
                yield folder, library


def _refuse_missing_tools(installation: Installation) -> None:
    path = os.environ.get("PATH", os.defpath)
    if installation.root != MACHINE:
        path = os.pathsep.join(str(installation.root / prefix / "bin") for prefix in PREFIXES)
    own = str(installation.root / installation.prefix / "bin")
    missing = [
        tool.removeprefix("{bin}/")
        for tool in installation.build.tools
        if not shutil.which(tool.replace("{bin}", own), path=path)
    ]
    if missing:
        raise MissingStackError(
            f"{installation.title} is installed, but {' and '.join(missing)}, which the peer is"
            " compiled with, is not",
            hint=f"apt-get install {installation.build.packages}",
        )
