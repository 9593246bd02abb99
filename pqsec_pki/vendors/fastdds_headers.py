"""Finds the headers that a build of Fast DDS was installed with, and those of its Fast CDR.

Each has a header with its version, by which its folder is known. Debian puts it into
`include/TRIPLET/`, beside the others. ROS 2's packages give each project a folder of headers
(`include/fastrtps/fastrtps/config.h`; CMake's APPEND_PROJECT_NAME_TO_INCLUDEDIR). A colcon
workspace has the one or the other form, below a folder for each package or below one for all.
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors.cyclone_plugins import agree
from pqsec_pki.vendors.exports import Version

_LIBRARIES = ("lib", "lib64", "lib/*-linux-gnu*")
_SYSTEM = ("usr/local", "usr")


@dataclass(frozen=True, slots=True, kw_only=True)
class Project:
    """A project with headers and a library."""

    name: str
    """Of its package, and of its folder of headers."""
    title: str
    header: str
    """The header with the version."""
    macro: str

    def version_in(self, path: Path) -> Version:
        """The version that the header at `path` defines; () if it defines none."""
        text = path.read_text(errors="replace") if path.is_file() else ""
        number = r"([0-9]{1,4}(?:\.[0-9]{1,4}){0,3})"
        found = re.search(rf'#define {self.macro}_VERSION_STR "{number}"', text)
        return tuple(map(int, found[1].split("."))) if found else ()


_PRODUCT = Stack.FASTDDS.product
FAST_DDS = {
    2: Project(name="fastrtps", title=_PRODUCT, header="fastrtps/config.h", macro="FASTRTPS"),
    3: Project(
        name=Stack.FASTDDS.value, title=_PRODUCT, header="fastdds/config.hpp", macro="FASTDDS"
    ),
}
FAST_CDR = Project(name="fastcdr", title="Fast CDR", header="fastcdr/config.h", macro="FASTCDR")


@dataclass(frozen=True, slots=True)
class Headers:
    """Where the headers of a project are; those of other versions if there are no others."""

    folders: tuple[Path, ...] = ()
    """For a compiler."""
    version: Version = ()


@dataclass(frozen=True, slots=True)
class Places:
    """Where to look for what a library was installed with; folders outside `root` are left out."""

    links: tuple[Path, ...]
    """The paths of the library: as it was named, and the file itself."""
    root: Path
    named: tuple[Path, ...] = ()
    """Folders of headers that the user named; they come first."""

    def headers(self, project: Project, release: Version) -> Headers:
        """Those of that release, as far as it is known. A compiler would see those in a folder that
        the user named, so no others are looked for then."""
        other = Headers()
        with disk_errors(self.root):
            for folders, is_named in self._folders(project):
                version = project.version_in(folders[0] / project.header)
                if version and agree(version, release):
                    return Headers(folders, version)
                other = Headers((), version) if version else other
                if version and is_named:
                    break
        return other

    def folder_of(self, library: str, project: Project, headers: Headers) -> Path | None:
        """The folder of another library, by its file's name; None if only the linker knows it."""
        near = [above for folder in headers.folders for above in folder.parents]
        with disk_errors(self.root):
            for prefix in self._prefixes(project, near):
                for pattern in _LIBRARIES:
                    for folder in sorted(prefix.glob(pattern)):
                        if (folder / library).is_file():
                            return folder
        return None

    def _folders(self, project: Project) -> Iterator[tuple[tuple[Path, ...], bool]]:
        for named in self.named:
            yield from ((each, True) for each in _below(named, project))
        for prefix in self._prefixes(project):
            yield from ((each, False) for each in _below(prefix / "include", project))

    def _prefixes(self, project: Project, more: Iterable[Path] = ()) -> Iterator[Path]:
        """Above the library, each also with the project's own folder; then the system's for what
        is not Fast DDS itself."""
        own = [above for link in self.links for above in link.parents]
        for above in dict.fromkeys((*own, *more)):
            if above.is_relative_to(self.root):
                yield from (above, above / project.name)
        if project is FAST_CDR:
            yield from (self.root / each for each in _SYSTEM)


def _below(include: Path, project: Project) -> Iterator[tuple[Path, ...]]:
    """Folders for a compiler: the header with the version may be in the first."""
    yield (include,)
    yield from ((each, include) for each in sorted(include.glob("*-linux-gnu*")))
    yield (include / project.name,)
