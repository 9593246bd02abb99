"""The root file systems with the stacks: this machine's and, for newer ones, Debian trixie's."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.trial import MACHINE, Installation
from pqsec_pki.trial.building import run_tool, source

TRIXIE = Path(os.environ.get("PQSEC_TRIXIE") or Path.home() / ".cache" / "pqsec-ci" / "trixie")
ROOTS = {"bookworm": MACHINE, "trixie": TRIXIE}


@contextmanager
def compiled(
    installation: Installation, sources: Mapping[str, bytes], *options: str
) -> Iterator[list[str]]:
    """The command of a peer with some other sources, compiled with more options."""
    parent = None if installation.root == MACHINE else installation.root / "tmp"
    with TemporaryDirectory(dir=parent) as name:
        folder = Path(name)
        own = {each: source(each) for each in installation.build.sources}
        for each, content in (own | dict(sources)).items():
            (folder / each).write_bytes(content)
        place = f"/{folder.relative_to(installation.root)}"
        for command in installation.build.commands:
            code, said = run_tool(command[0], installation.tool((*command, *options), place))
            assert code == 0, said
        yield installation.peer(folder / "peer")
