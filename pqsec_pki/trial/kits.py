"""What a stack's peers are compiled with, one row for each line of versions."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pqsec_pki.vendors.cyclone_plugins import installed_plugins

Command = tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Kit:
    """How to compile a peer, and how to see that it can be."""

    stack: str
    """Its name in the room `vendors`."""
    title: str
    header: str
    """The file that tells the version: a pattern below a folder of headers."""
    macro: str
    """What is the version in there."""
    sources: tuple[str, ...]
    """In the folder peers/, all that the peer is made of."""
    commands: tuple[Command, ...]
    """One after the other, in a folder with the sources; the last makes `peer`."""
    packages: str
    """Of Debian and Ubuntu."""
    open: str
    """The configuration, in peers/, of a participant without credentials."""
    variable: str
    """Of the environment: it names the configuration."""
    plugins: Callable[[Path], Path | None] = lambda _: None
    """Where its security plugins are below a root, for a stack that must be told."""

    @property
    def tools(self) -> Iterator[str]:
        """The commands that must be there."""
        yield from (command[0] for command in self.commands)


def _fastdds(major: int, header: str, macro: str, *libraries: str, package: str) -> Kit:
    name = {2: "FASTRTPS", 3: "FASTDDS"}[major]
    return Kit(
        stack="fastdds",
        title="Fast DDS",
        header=header,
        macro=macro,
        sources=("fastdds.cpp",),
        commands=(("g++", "-O0", "-o", "peer", "fastdds.cpp", *libraries),),
        packages=f"g++ {package}",
        open="fastdds.open.xml",
        variable=f"{name}_DEFAULT_PROFILES_FILE",
    )


KITS = (
    Kit(
        stack="cyclonedds",
        title="Cyclone DDS",
        header="dds/version.h",
        macro="DDS_VERSION",
        sources=("Sample.idl", "cyclonedds.c"),
        commands=(
            ("idlc", "Sample.idl"),
            ("gcc", "-O0", "-I.", "-o", "peer", "cyclonedds.c", "Sample.c", "-lddsc"),
        ),
        packages="gcc libc6-dev cyclonedds-dev cyclonedds-tools",
        open="cyclonedds.open.xml",
        variable="CYCLONEDDS_URI",
        plugins=installed_plugins,
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
STACKS = tuple(dict.fromkeys(kit.stack for kit in KITS))
"""Those that can be tried."""
