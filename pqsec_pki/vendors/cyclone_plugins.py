"""Cyclone DDS's own security plugins: where they are, and which Cyclone DDS they belong to.

A plugin is linked to the libddsc that it was built with. If a process with another libddsc loads
it, both libraries are loaded, and it crashes with SIGSEGV (11.0.1 with the plugins of Debian's
0.10.2, measured). So a plugin is checked before its path is written.
"""

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import resolved
from pqsec_pki.errors import PqsecError, shown
from pqsec_pki.vendors.elf import Library, read_library, release_in, runs_here
from pqsec_pki.vendors.exports import Version

NAMES = {"auth": "dds_security_auth", "crypto": "dds_security_crypto", "ac": "dds_security_ac"}
PLACES = (
    "usr/lib/*/libddsc0debian",
    "usr/lib/*/libddsc*",
    "usr/lib/*",
    "usr/lib",
    "usr/local/lib",
    "usr/local/lib64",
    "usr/local/lib/*",
    "opt/ros/*/lib/*",
    "opt/ros/*/lib",
)
"""Below /: where distributions, `make install` and ROS 2 put the plugins."""
_CYCLONE = "libddsc.so"


@dataclass(frozen=True, slots=True, kw_only=True)
class CyclonePlugin:
    """One of the plugins, and the Cyclone DDS that it belongs to."""

    path: Path
    soname: str
    """The libddsc that it is linked to, such as libddsc.so.0debian; empty if to none."""
    library: Path | None
    """The path of that libddsc, links resolved, if it is beside the plugin or one folder above."""

    @property
    def release(self) -> Version:
        """The version of that libddsc, as far as file names show it; () if they do not."""
        return release_in(self.library.name if self.library else self.soname)

    @property
    def owner(self) -> str:
        """The Cyclone DDS that it belongs to, in words."""
        of = shown(self.library.name if self.library else self.soname)
        return f"linked to {of} of Cyclone DDS {in_words(self.release)}"


def in_words(release: Version) -> str:
    """The version as text: 0.10.2; `of unknown version` for ()."""
    return ".".join(map(str, release)) or "of unknown version"


def agree(one: Version, other: Version) -> bool:
    """Whether both can be the same version, as far as both are known."""
    return all(a == b for a, b in zip(one, other, strict=False))


def read_plugin(path: Path) -> CyclonePlugin:
    """The plugin at `path`; FileError if it cannot be read, MalformedError if not a library."""
    return _plugin(read_library(path))


def _plugin(found: Library) -> CyclonePlugin:
    soname = next((each for each in found.needed if each.startswith(_CYCLONE)), "")
    places = (found.path.parent / soname, found.path.parent.parent / soname)
    library = next((each.resolve() for each in places if soname and each.is_file()), None)
    return CyclonePlugin(path=found.path, soname=soname, library=library)


def plugins_in(folder: Path) -> dict[str, Path]:
    """Kind -> path, for all three plugins."""
    return {kind: folder / f"lib{name}.so" for kind, name in NAMES.items()}


def installed(root: Path) -> Iterator[tuple[Path, CyclonePlugin]]:
    """The folders below `root` that have all plugins, each with its first one.

    Folders that the user may not read are skipped, as are files that are not libraries or are for
    another processor.
    """
    found = {resolved(folder) for place in PLACES for folder in root.glob(place)}
    for folder in sorted(found):
        with suppress(PqsecError, OSError):
            libraries = [read_library(path) for path in plugins_in(folder).values()]
            if all(map(runs_here, libraries)):
                yield folder, _plugin(libraries[0])


def find_cyclone_plugins(
    root: Path, fits: Callable[[CyclonePlugin], bool] = lambda _: True
) -> Path | None:
    """The one folder below `root` with plugins that fit; None if there is none, or several."""
    found = [folder for folder, plugin in installed(root) if fits(plugin)]
    return found[0] if len(found) == 1 else None


def mixed(plugins: Collection[CyclonePlugin], release: Version) -> str:
    """Why one process of that version cannot load them all; empty if it can."""
    for each in plugins:
        if not agree(each.release, release):
            return (
                f"{each.path} is {each.owner}, and not for a process of Cyclone DDS"
                f" {in_words(release)}: a process with parts of both can crash"
            )
    for one, other in pairwise(each for each in plugins if each.soname):
        if (one.soname, one.library) != (other.soname, other.library):
            return (
                f"{one.path} is {one.owner}, and {other.path} is {other.owner}: a process with"
                " parts of both can crash"
            )
    return ""
