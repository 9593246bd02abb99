"""The root file systems with the stacks: this machine's and, for newer ones, Debian trixie's."""

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.trial import MACHINE, Installation
from pqsec_pki.trial.building import run_tool, source
from tests.interop.kept import kept

TRIXIE = Path(os.environ.get("PQSEC_TRIXIE") or Path.home() / ".cache" / "pqsec-ci" / "trixie")
ROOTS = {"bookworm": MACHINE, "trixie": TRIXIE}


@contextmanager
def compiled(
    installation: Installation, sources: Mapping[str, bytes], *options: str
) -> Iterator[list[str]]:
    """The command of a peer with some other sources, compiled with more options.

    The program is kept beside those of `pqsec try`: Fast DDS's headers take half a minute.
    """
    own = {each: source(each) for each in installation.build.sources} | dict(sources)
    inputs = (installation.root, installation.library.build, installation.build.commands)

    def make(goal: Path) -> None:
        with _folder(installation) as folder:
            _compile(installation, folder, own, options)
            shutil.copy(folder / "peer", goal)

    made = kept(installation.build.stack, (inputs, options, sorted(own.items())), make)
    with _folder(installation) as folder:
        shutil.copy(made / "peer", folder)
        yield installation.peer(folder / "peer")


@contextmanager
def _folder(installation: Installation) -> Iterator[Path]:
    """One that its programs see."""
    parent = None if installation.root == MACHINE else installation.root / "tmp"
    with TemporaryDirectory(dir=parent) as name:
        yield Path(name)


def _compile(
    installation: Installation, folder: Path, sources: Mapping[str, bytes], options: Iterable[str]
) -> None:
    for each, content in sources.items():
        (folder / each).write_bytes(content)
    place = f"/{folder.relative_to(installation.root)}"
    for command in installation.build.commands:
        code, said = run_tool(command[0], installation.tool((*command, *options), place))
        assert code == 0, said
