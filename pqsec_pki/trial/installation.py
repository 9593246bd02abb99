"""A stack as it is installed on this machine, or in a root file system beside it."""

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pqsec_pki._files import disk_errors
from pqsec_pki.errors import PqsecError, UsageError
from pqsec_pki.trial.kits import KITS, STACKS, Kit

MACHINE = Path("/")
_PREFIXES = ("usr/local", "usr")


class MissingStackError(PqsecError):
    """A stack, or what its peers are compiled with, is not installed."""


@dataclass(frozen=True, slots=True)
class Installation:
    """One version of a stack, with its headers and libraries below `root`."""

    kit: Kit
    version: str
    root: Path

    @property
    def title(self) -> str:
        """As in `Cyclone DDS 0.10.2`."""
        return f"{self.kit.title} {self.version}"

    def tool(self, command: tuple[str, ...], folder: str) -> list[str]:
        """What runs a compiler's `command` in `folder`, a path below the root."""
        there = ["env", "-C", folder, *command]
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
        return [str(loaders[0]), "--library-path", str(loaders[0].parent), str(program)]


def find(stack: str, root: Path = MACHINE) -> Installation:
    """The stack called `stack` below `root`: what a compiler takes, of the newest generation.

    UsageError for a stack that cannot be tried, MissingStackError, naming the packages, if
    it is not installed or cannot be compiled against.
    """
    if stack not in STACKS:
        raise UsageError(f"{stack!r} cannot be tried", hint=f"these can: {', '.join(STACKS)}")
    kits = [kit for kit in KITS if kit.stack == stack]
    with disk_errors(root):
        found = [each for kit in kits for each in _installed(kit, root.absolute())]
    if not found:
        raise MissingStackError(
            f"{kits[0].title} is not installed with its headers below {root}",
            hint=" or: ".join(f"apt-get install {kit.packages}" for kit in reversed(kits)),
        )
    _refuse_missing_tools(found[0])
    return found[0]


def _installed(kit: Kit, root: Path) -> Iterator[Installation]:
    version = re.compile(rf'#define {kit.macro} "([0-9.]+)"')
    for prefix in _PREFIXES:
        headers = root / prefix / "include"
        for path in [headers / kit.header, *sorted(headers.glob(f"*-linux-gnu*/{kit.header}"))]:
            text = path.read_text(errors="replace") if path.is_file() else ""
            if match := version.search(text):
                yield Installation(kit, match[1], root)


def _refuse_missing_tools(installation: Installation) -> None:
    places = [os.environ.get("PATH", os.defpath)]
    if installation.root != MACHINE:
        places = [str(installation.root / prefix / "bin") for prefix in _PREFIXES]
    path = os.pathsep.join(places)
    missing = [tool for tool in installation.kit.tools if not shutil.which(tool, path=path)]
    if missing:
        raise MissingStackError(
            f"{installation.title} is here, but not {' and '.join(missing)},"
            " which the peer of the trial is made with",
            hint=f"apt-get install {installation.kit.packages}",
        )
