"""A stack as it is installed on this machine, or in a root file system beside it.

Headers, library, tools and plugins of one prefix belong together. A compiler left to itself takes
the headers of /usr/local and the library of /usr; what it makes is neither version's.
"""

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pqsec_pki._files import disk_errors
from pqsec_pki.errors import PqsecError, UsageError, shown
from pqsec_pki.trial.peer_builds import PEER_BUILDS, STACKS, Command, PeerBuild
from pqsec_pki.vendors.cyclone_plugins import agree, in_words
from pqsec_pki.vendors.elf import Library, read_library, runs_here

MACHINE = Path("/")
PREFIXES = ("usr/local", "usr")
"""In the order in which a compiler looks for headers."""
_FOLDERS = ("lib", "lib64", "lib/*-linux-gnu*")
_UNFIT = ":;$"
"""What the loader takes for its own in the name of a folder (ld.so(8))."""


class MissingStackError(PqsecError):
    """A stack, or what its peers are compiled with, is not installed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Installation:
    """One version of a stack, with its headers and libraries below `root`."""

    build: PeerBuild
    version: str
    """That of the library, which peers are linked to and run with."""
    root: Path
    prefix: str
    """Below the root, one of PREFIXES."""
    folder: Path
    """Where the library is found."""
    library: Library

    @property
    def title(self) -> str:
        """As in `Cyclone DDS 0.10.2`."""
        return f"{self.build.title} {self.version}"

    @property
    def soname(self) -> str:
        """The name by which the library is loaded."""
        return self.library.soname or self.build.library

    @property
    def plugins(self) -> Path | None:
        """The folder of the security plugins that belong to this library, if they are apart."""
        return self.build.plugins(self.root, self.library.path) if self.build.plugins else None

    def tool(self, command: Command, folder: str) -> list[str]:
        """What runs a compiler's `command` in `folder`, a path below the root."""
        there = ["env", "-C", folder, *map(self._said, command)]
        if self.root == MACHINE:
            return there
        become_root = [] if os.geteuid() == 0 else ["unshare", "-r"]
        return [*become_root, "chroot", str(self.root), *there]

    def peer(self, program: Path) -> list[str]:
        """What runs a compiled `program`; in another root, with the libraries there."""
        if self.root == MACHINE:
            return [str(program)]
        loaders = sorted(self.root.glob("usr/lib/*-linux-gnu*/ld-linux*.so.*"))
        if not loaders:
            raise MissingStackError(
                f"below {self.root} there is nothing that starts programs: usr/lib/*/ld-linux*",
                hint="give --root the root file system of a Debian or Ubuntu",
            )
        places = dict.fromkeys([self.folder, *self._folders(), loaders[0].parent])
        return [str(loaders[0]), "--library-path", ":".join(map(str, places)), str(program)]

    def _said(self, word: str) -> str:
        """A word of a command, with the places of this installation in."""
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
        """Where the loader looks below the root, besides."""
        for prefix in PREFIXES:
            yield from folders_of_libraries(self.root / prefix)


def folders_of_libraries(prefix: Path) -> Iterator[Path]:
    """Those that are there below `prefix`."""
    for pattern in _FOLDERS:
        yield from (each for each in sorted(prefix.glob(pattern)) if each.is_dir())


def find(stack: str, root: Path = MACHINE) -> Installation:
    """The stack called `stack` below `root`: the one whose headers a compiler takes.

    UsageError for a stack that cannot be tried. MissingStackError, naming the packages, if it is
    not installed, cannot be compiled against, or if its headers, its library and its plugins
    are not of one version.
    """
    if stack not in STACKS:
        raise UsageError(f"{stack!r} cannot be tried", hint=f"these can: {', '.join(STACKS)}")
    root = root.absolute()
    if unfit := sorted(set(_UNFIT) & set(str(root))):
        raise UsageError(f"{shown(str(root))}: nothing is loaded from a folder with {unfit[0]!r}")
    peer_builds = [build for build in PEER_BUILDS if build.stack == stack]
    with disk_errors(root):
        headers = next(_headers(peer_builds, root), None)
        if headers is None:
            raise MissingStackError(
                f"{peer_builds[0].title} is not installed with its headers below {root}",
                hint=" or: ".join(
                    f"apt-get install {build.packages}" for build in reversed(peer_builds)
                ),
            )
        found = _whole(*headers, root)
        _refuse_missing_tools(found)
    return found


def _headers(peer_builds: list[PeerBuild], root: Path) -> Iterator[tuple[PeerBuild, str, str]]:
    """(kit, version, prefix) of headers, those first that a compiler takes first."""
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


def _whole(build: PeerBuild, version: str, prefix: str, root: Path) -> Installation:
    """With the library of the same prefix; MissingStackError if it is of another version."""
    headers = f"the headers of {build.title} {version} are in {root / prefix / 'include'}"
    hint = f"install all of one version there, or take the headers away: {build.packages}"
    found_in = next(_libraries(build, root / prefix), None)
    if found_in is None:
        raise MissingStackError(
            f"{headers}, and {build.library} is not in {root / prefix / 'lib'}", hint=hint
        )
    folder, library = found_in
    told = tuple(map(int, version.split(".")))
    if not agree(told, library.release):
        raise MissingStackError(
            f"{headers}, and {library.path} is of {in_words(library.release)}", hint=hint
        )
    if library.soname and (folder / library.soname).resolve() != library.path:
        raise MissingStackError(
            f"{folder / shown(library.soname)}, which programs load, is not {library.path}",
            hint=f"`ldconfig -n {folder}` makes the link",
        )
    found = Installation(
        build=build,
        version=in_words(max(library.release, told, key=len)),
        root=root,
        prefix=prefix,
        folder=folder,
        library=library,
    )
    if build.plugins and found.plugins is None:
        raise MissingStackError(
            f"{found.title} in {folder} is here without security plugins of its own",
            hint="install them beside it: they are built with ENABLE_SECURITY",
        )
    return found


def _libraries(build: PeerBuild, prefix: Path) -> Iterator[tuple[Path, Library]]:
    """(folder, library) of those below `prefix` that a peer could load."""
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
            f"{installation.title} is here, but not {' and '.join(missing)},"
            " which the peer of the trial is made with",
            hint=f"apt-get install {installation.build.packages}",
        )
