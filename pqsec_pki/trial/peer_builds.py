"""How the peers of each stack are compiled, one row for each series of versions."""

from collections.abc import Callable, Iterator
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import find_cyclone_plugins

Command = tuple[str, ...]
"""Words; {bin}, {include} and {lib} are replaced by the folders of the stack's prefix as the
compiler sees them, and {run} by the folder of its library as the peer sees it."""
_LIBRARY = ("-L{lib}", "-Wl,--disable-new-dtags", "-Xlinker", "-rpath", "-Xlinker", "{run}")
"""The linked library is the one that is loaded, despite LD_LIBRARY_PATH (ld.so(8), DT_RPATH)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerBuild:
    """How to compile a peer, and how to find what it needs."""

    stack: Stack
    header: str
    """The header with the version: a pattern below a folder of headers."""
    macro: str
    """The macro that defines the version there."""
    library: str
    """The library that a peer is linked to, in a folder of libraries."""
    sources: tuple[str, ...]
    """The peer's source files, in the folder peers/."""
    commands: tuple[Command, ...]
    """Run in order in a folder with the sources; the last one creates `peer`."""
    packages: str
    """Packages of Debian and Ubuntu."""
    open: str
    """The configuration, in peers/, of a participant without credentials."""
    variable: str
    """The environment variable that names the configuration."""
    plugins: Callable[[Path, Path], Path | None] | None = None
    """Finds a library's security plugins below a root, for a stack that needs their folder."""

    @property
    def tools(self) -> Iterator[str]:
        """The commands that must be installed."""
        yield from (command[0] for command in self.commands)


def _fastdds(major: int, header: str, macro: str, *libraries: str, package: str) -> PeerBuild:
    name = {2: "FASTRTPS", 3: "FASTDDS"}[major]
    return PeerBuild(
        stack=Stack.FASTDDS,
        header=header,
        macro=macro,
        library=f"{libraries[0].replace('-l', 'lib')}.so",
        sources=("fastdds.cpp", "fastdds_host.hpp"),
        commands=(
            ("g++", "-O0", "-I{include}", *_LIBRARY, "-o", "peer", "fastdds.cpp", *libraries),
        ),
        packages=f"g++ {package}",
        open="fastdds.open.xml",
        variable=f"{name}_DEFAULT_PROFILES_FILE",
    )


PEER_BUILDS = (
    PeerBuild(
        stack=Stack.CYCLONEDDS,
        header="dds/version.h",
        macro="DDS_VERSION",
        library="libddsc.so",
        sources=("Sample.idl", "cyclonedds.c", "cyclonedds_host.h"),
        commands=(
            ("{bin}/idlc", "Sample.idl"),
            (
                *("gcc", "-O0", "-I.", "-I{include}", *_LIBRARY),
                *("-o", "peer", "cyclonedds.c", "Sample.c", "-lddsc"),
            ),
        ),
        packages="gcc libc6-dev cyclonedds-dev cyclonedds-tools",
        open="cyclonedds.open.xml",
        variable="CYCLONEDDS_URI",
        plugins=lambda root, library: find_cyclone_plugins(root, lambda it: it.library == library),
    ),
    _fastdds(
        3,
        "fastdds/config.hpp",
        "FASTDDS_VERSION_STR",
        *("-lfastdds", "-lfastcdr"),
        package="libfastdds-dev",
    ),
    _fastdds(
        2,
        "fastrtps/config.h",
        "FASTRTPS_VERSION_STR",
        *("-lfastrtps", "-lfastcdr"),
        package="libfastrtps-dev",
    ),
)
STACKS = tuple(dict.fromkeys(build.stack for build in PEER_BUILDS))
"""The stacks that can be tried."""
