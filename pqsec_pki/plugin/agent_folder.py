"""The folder where a user's agent listens and writes. `shim/agent.c` has the same in C.

Only the user may create files there, so that no other user can block the agent: the runtime
folder, which the environment names or systemd creates for logged-in users, else the user's home.
/tmp, where any user can create files, is used only if there is neither; a folder of another user
is then refused.
"""

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki._places import refuse_outsiders
from pqsec_pki.errors import FileError

_OTHERS = 0o077
_WRITABLE = 0o022
"""Permission bits that let other users write."""
_RUN_USER = Path("/run/user")
_INSTEAD = "if another user made it, set HOME or XDG_RUNTIME_DIR to folders of your own"
_MAX_FOLDER = 85
"""Octets. A socket's path has at most 108 with its NUL, and a file's name here up to 22."""


@dataclass(frozen=True, slots=True)
class AgentFolder:
    """A folder that only its user can enter, with socket, lock and log."""

    socket: Path

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Self:
        """In the user's $XDG_RUNTIME_DIR, /run/user/UID or $HOME, in that order; else in /tmp."""
        runtime, home = environment.get("XDG_RUNTIME_DIR", ""), environment.get("HOME", "")
        for folder in (runtime, str(_RUN_USER / str(os.geteuid()))):
            if folder.startswith("/") and _is_own_folder(Path(folder), 0):
                return cls(Path(folder, "pqsec", "agent.sock"))
        if _is_good_home(home):
            return cls(Path(home, ".pqsec", "agent.sock"))
        return cls(Path(f"/tmp/pqsec-{os.geteuid()}", "agent.sock"))  # noqa: S108 -- see above

    @property
    def folder(self) -> Path:
        return self.socket.parent

    @property
    def lock(self) -> Path:
        """The lock file. An agent holds the lock while it starts or stops."""
        return self.folder / "agent.lock"

    @property
    def log(self) -> Path:
        return self.folder / "agent.log"

    @property
    def own_retired(self) -> Self:
        """The socket of this process after it has retired."""
        return type(self)(self.folder / f"retired-{os.getpid()}.sock")

    @property
    def retired(self) -> list[Self]:
        """Sockets of agents that serve no new hosts; some agents may have been killed."""
        return [type(self)(path) for path in sorted(self.folder.glob("retired-*.sock"))]

    def prepare(self) -> None:
        """Create the folder; FileError if other users own it or may enter it."""
        with disk_errors(self.folder):
            self.folder.mkdir(mode=0o700, exist_ok=True)
        self.is_there()

    def is_there(self) -> bool:
        """Whether the folder exists; FileError if other users own it, may enter or replace it.

        In /tmp, anyone can create a folder of that name, with a socket and a log in it.
        """
        if not os.path.lexists(self.folder):
            return False
        if not _is_own_folder(self.folder, _OTHERS):
            raise FileError(
                f"{self.folder} is not a folder of this user's alone",
                hint=_INSTEAD,
            )
        words = "anyone who may write there can answer in place of the agent"
        refuse_outsiders([self.folder], words, instead=_INSTEAD)
        return True


def _is_good_home(home: str) -> bool:
    """Whether only the user can create a folder there, with a socket in it.

    It may be a link: root creates homes.
    """
    if not home.startswith("/") or home == "/":
        return False
    try:
        found = os.stat(home)  # noqa: PTH116 -- as C does, whatever stands in the name
    except (OSError, ValueError):
        return False
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    good = own and not found.st_mode & _WRITABLE and os.access(home, os.W_OK)
    return good and len(os.fsencode(f"{home}/.pqsec")) <= _MAX_FOLDER


def _is_own_folder(path: Path, forbidden: int) -> bool:
    try:
        found = path.lstat()
    except OSError:
        return False
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    return own and not found.st_mode & forbidden
