"""EST clients of others, and a server, of newer Debian, where .ci/est-clients puts them."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.longer import LONG

SUITES = ["trixie", *(["sid"] if LONG else [])]


class Clients:
    """Programs of another Debian, and a folder that they share with the test."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root, self.folder = root, folder

    def run(self, *command: str, data: bytes = b"") -> bytes:
        """What a program of that root prints."""
        return ran(self.line(*command), data)

    def line(self, *command: str) -> list[Any]:
        """The command line of a program of that root, in the folder."""
        place = f"/{self.folder.relative_to(self.root)}"
        become_root = [] if os.geteuid() == 0 else ["unshare", "-r"]
        return [*become_root, "chroot", self.root, "env", f"--chdir={place}", *command]


def ran(line: list[Any], data: bytes = b"") -> bytes:
    done = subprocess.run(line, input=data, capture_output=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def root_of(suite: str) -> Path | None:
    """The root with that suite of Debian; None if it is not on this machine."""
    kept = Path.home() / ".cache/pqsec-ci" / f"est-clients-{suite}"
    there = Path(os.environ.get(f"PQSEC_EST_CLIENTS_{suite.upper()}") or kept)
    return there if there.exists() else None


@contextmanager
def clients_in(root: Path) -> Iterator[Clients]:
    """Those of a root, with a new folder."""
    (root / "tmp").mkdir(exist_ok=True)
    with TemporaryDirectory(dir=root / "tmp") as folder:
        yield Clients(root, Path(folder))
