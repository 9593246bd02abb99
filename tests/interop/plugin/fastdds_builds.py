"""Builds of Fast DDS that no distribution has: each has a prefix, which a variable names.

They are built by hand from the project's tags, with -DSECURITY=ON, and Fast CDR in the same prefix.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pqsec_pki.trial import MACHINE, Installation
from pqsec_pki.trial.installation import folders_of_libraries
from pqsec_pki.trial.peer_builds import PEER_BUILDS
from pqsec_pki.vendors import FastDds, examine, in_words
from pqsec_pki.vendors.fastdds_headers import FAST_DDS

VARIABLES = {
    "2.14.6": "PQSEC_FASTDDS_2_14",
    "3.2.5": "PQSEC_FASTDDS_3_2",
    "3.6.2": "PQSEC_FASTDDS_3_6",
}


def build_of(version: str, requires: Callable[..., str]) -> FastDds:
    """The build of exactly that version; a test without it is skipped, and says how to get it."""
    variable = VARIABLES[version]
    remedy = f"build it with -DSECURITY=ON, and set {variable} to its prefix"
    return in_prefix(
        Path(requires(os.environ.get(variable), f"Fast DDS {version}", remedy)), version
    )


def in_prefix(prefix: Path, version: str) -> FastDds:
    """The Fast DDS in that prefix; AssertionError if it says that it is another version.

    The tag v3.6.2 says 3.6.2.0.
    """
    name = FAST_DDS[int(version[0])].name
    paths = [each / f"lib{name}.so" for each in folders_of_libraries(prefix)]
    [library] = {each.resolve() for each in paths if each.exists()}
    found = examine(library)
    assert in_words(found.version[:3]) == version, f"{library} is {found.title}, not {version}"
    return found


def installation_of(stack: FastDds) -> Installation:
    """The build for `pqsec try`, which finds none outside the system's folders itself."""
    name = f"lib{FAST_DDS[stack.generation].name}.so"
    [row] = [each for each in PEER_BUILDS if each.library == name]
    include = [f"-I{each}" for each in stack.include]
    commands = tuple(
        tuple(word for each in command for word in (include if each == "-I{include}" else [each]))
        for command in row.commands
    )
    folder = stack.library.path.parent
    return Installation(
        build=replace(row, commands=commands),
        version=in_words(stack.version),
        root=MACHINE,
        prefix=str(folder.parent.relative_to(MACHINE)),
        folder=folder,
        library=stack.library,
    )
