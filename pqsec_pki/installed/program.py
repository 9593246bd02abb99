"""The program on this machine: where it is, and what came with it."""

import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from shlex import quote

import pqsec_pki
from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, exists, read
from pqsec_pki._packages import extensions
from pqsec_pki.plugin import home

DEBIAN = Path("/usr/lib/pqsec")
_RECEIPTS = {
    "pipx_metadata.json": "pipx uninstall pqsec",
    "uv-receipt.toml": "uv tool uninstall pqsec",
}
"""File that an installer leaves in the environment -> how it removes that."""
_SHARED = ("/usr/share", "/usr/local/share")
_COMPLETIONS = (
    "bash-completion/completions/pqsec",
    "zsh/site-functions/_pqsec",
    "zsh/vendor-completions/_pqsec",
    "fish/vendor_completions.d/pqsec.fish",
)
_VARIABLE = b"_PQSEC_COMPLETE"
_STARTED = (".bashrc", ".bash_profile", ".profile", ".zshrc")
"""Files that a shell reads when it starts."""
_WITH_IT = "with the program"


@dataclass(frozen=True, slots=True)
class Place:
    """Something of pqsec on this machine."""

    what: str
    path: Path
    removed_by: str
    """A command, or words."""
    line: int | None = None
    """The line, if it is one in a file."""

    def to_json(self) -> dict[str, object]:
        """The place for --json."""
        where = {"line": self.line} if self.line else {}
        return {"what": self.what, "path": self.path, **where, "removed_by": self.removed_by}


def programs(environment: Mapping[str, str]) -> Iterator[Place]:
    """The program, commands on the search path, manual pages, completion, and extensions."""
    yield Place("program", Path(pqsec_pki.__file__).parent, _uninstalled_by(Path(sys.prefix)))
    for folder in dict.fromkeys(environment.get("PATH", "").split(os.pathsep)):
        if folder.startswith("/") and (command := shutil.which("pqsec", path=folder)):
            yield Place("command", Path(command), "with its program")
    shared = [Path(sys.prefix, "share"), *map(Path, _SHARED), home() / ".local/share"]
    for each in shared:
        manuals = each / "man" / "man1"
        if next(manuals.glob("pqsec*.1*"), None):
            yield Place("manual pages", manuals / "pqsec*.1*", _WITH_IT)
    yield from _completion(environment, shared)
    for name, folder in extensions():
        removal = f"{quote(sys.executable)} -m pip uninstall {quote(name)}"
        yield Place(f"extension, {name}", Path(folder), removal)


def _uninstalled_by(prefix: Path) -> str:
    for name, command in _RECEIPTS.items():
        if (prefix / name).is_file():
            return command
    if prefix == DEBIAN:
        return "apt-get purge pqsec"
    return f"{quote(sys.executable)} -m pip uninstall pqsec"


def _completion(environment: Mapping[str, str], shared: list[Path]) -> Iterator[Place]:
    for path in (folder / name for folder in shared for name in _COMPLETIONS):
        if path.is_file():
            yield Place("completion", path, _WITH_IT)
    settings = environment.get("XDG_CONFIG_HOME") or home() / ".config"
    fish = Path(settings, "fish/completions/pqsec.fish")
    if exists(fish):
        yield Place("completion", fish, f"rm {quote(str(fish))}")
    for name in _STARTED:
        path = home() / name
        if exists(path):
            with disk_errors(path):
                lines = read(path).splitlines()
            for number, line in enumerate(lines, 1):
                if _VARIABLE in line:
                    yield Place("completion", path, "delete that line", number)
