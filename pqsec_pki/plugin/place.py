"""Where the agent of a user listens and writes. `shim/agent.c` says the same in C."""

import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from pqsec_pki._files import disk_errors
from pqsec_pki.errors import FileError

_OTHERS = 0o077


@dataclass(frozen=True, slots=True)
class Place:
    """A folder that nobody else can enter, with socket, lock and log."""

    socket: Path

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Self:
        """That of this user: in $XDG_RUNTIME_DIR if it is the user's, else in /tmp."""
        runtime = environment.get("XDG_RUNTIME_DIR", "")
        if runtime.startswith("/") and _is_own_folder(Path(runtime), 0):
            return cls(Path(runtime, "pqsec", "agent.sock"))
        return cls(Path(f"/tmp/pqsec-{os.geteuid()}", "agent.sock"))  # noqa: S108 -- see prepare

    @property
    def folder(self) -> Path:
        return self.socket.parent

    @property
    def lock(self) -> Path:
        """Held by an agent that begins to listen, or ends."""
        return self.folder / "agent.lock"

    @property
    def log(self) -> Path:
        return self.folder / "agent.log"

    def prepare(self) -> None:
        """Make the folder; FileError if it is not this user's alone."""
        with disk_errors(self.folder):
            self.folder.mkdir(mode=0o700, exist_ok=True)
        self.is_there()

    def is_there(self) -> bool:
        """Whether the folder is; FileError if it is not this user's alone.

        Anyone can make one of that name in /tmp, with a socket and a log in it.
        """
        if not os.path.lexists(self.folder):
            return False
        if not _is_own_folder(self.folder, _OTHERS):
            raise FileError(f"{self.folder} is not a folder of this user's alone")
        return True


def _is_own_folder(path: Path, forbidden: int) -> bool:
    try:
        found = path.lstat()
    except OSError:
        return False
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    return own and not found.st_mode & forbidden
