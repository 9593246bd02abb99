"""The library that a process of Fast DDS preloads to run pqsec's plugin."""

import re
from collections.abc import Mapping
from pathlib import Path

from pqsec_pki.errors import FileError, UsageError, shown
from pqsec_pki.vendors.cyclone_plugins import agree, in_words
from pqsec_pki.vendors.exports import Options, Version
from pqsec_pki.vendors.fastdds_adapter import installed
from pqsec_pki.vendors.own_plugin import PRELOAD

VARIABLE = "LD_PRELOAD"
NOTE = (
    "programs with file capabilities or setuid preload nothing, and Fast DDS refuses post-quantum"
    " keys there: link such a program with the library"
)
_SEPARATORS = re.compile("[ :]")
_UNFIT = re.compile(r"[\s:$]")
"""Characters that separate paths in LD_PRELOAD, or are replaced there (ld.so(8))."""


def preloaded(folder: Path, options: Options, release: Version = ()) -> Path:
    """The library of the plugin in `folder`.

    UsageError if the loader cannot load from that path, FileError if it is not for a Fast DDS of
    that release that is installed here.
    """
    path = folder.absolute() / PRELOAD
    if unfit := _UNFIT.search(str(path)):
        raise UsageError(
            f"{shown(str(folder))}: the loader preloads nothing from a folder with {unfit[0]!r} in"
            " its name",
            hint="install the plugin elsewhere: `pqsec plugin install fastdds --dir DIR`",
        )
    if options.at is None:  # another machine cannot be checked from here
        there = [each for each in installed(folder) if agree(each.release, release)]
        if all(each.problem for each in there):
            why = "; ".join(f"{each.library}: {each.problem}" for each in there)
            meant = f" {in_words(release)}" if release else ""
            raise FileError(
                f"the plugin in {shown(str(folder))} is not for the Fast DDS{meant} that is"
                f" installed{': ' if why else ''}{why}",
                hint="`pqsec plugin install fastdds` compiles it for that one",
            )
    return path


def preloaded_in(variables: Mapping[str, str]) -> Path | None:
    """The folder of the plugin that a process with these variables preloads, if it does."""
    paths = map(Path, _SEPARATORS.split(variables.get(VARIABLE, "")))
    return next((each.parent for each in paths if each.name == PRELOAD and each.is_file()), None)
