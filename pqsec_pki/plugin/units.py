"""Units for systemd, so that the agent is there before the first participant asks for it."""

import sys
from collections.abc import Mapping
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki.errors import FileError

NAME = "pqsec-agent"
_SOCKET = """\
# Written by `pqsec plugin install --systemd`.
[Unit]
Description=Where the pqsec agent is asked for

[Socket]
ListenStream=%t/pqsec/agent.sock
SocketMode=0600
DirectoryMode=0700

[Install]
WantedBy=sockets.target
"""
_SERVICE = """\
# Written by `pqsec plugin install --systemd`.
[Unit]
Description=pqsec agent: holds the keys of DDS participants
Requires={name}.socket
After={name}.socket

[Service]
ExecStart="{python}" -I -m pqsec_pki agent run
LimitCORE=0
NoNewPrivileges=yes

[Install]
WantedBy=default.target
Also={name}.socket
"""


def units_folder(environment: Mapping[str, str]) -> Path:
    """Where systemd looks for units of this user; FileError if there is no home."""
    found = environment.get("XDG_CONFIG_HOME", "")
    return (Path(found) if found.startswith("/") else home() / ".config") / "systemd" / "user"


def home() -> Path:
    """The user's folder; FileError if there is none."""
    try:
        return Path.home()
    except RuntimeError as error:
        raise FileError(
            "this user has no home folder", hint="set HOME, or name a folder"
        ) from error


def planned_units(folder: Path, *, force: bool) -> dict[Path, bytes]:
    """The socket and the service for this interpreter: what is to stand in which file.

    ExistsError for files that are there already and say something else, unless `force`.
    """
    service = _SERVICE.format(name=NAME, python=_quoted(sys.executable))
    texts = {f"{NAME}.socket": _SOCKET, f"{NAME}.service": service}
    units = {folder / name: text.encode() for name, text in texts.items()}
    for path, octets in units.items():
        if not (force or (path.is_file() and _files.read(path) == octets)):
            _files.refuse_existing(path)
    return units


def write_units(units: Mapping[Path, bytes]) -> None:
    """Put them there. FileError if that cannot be done."""
    for path, octets in units.items():
        with _files.disk_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            _files.write(path, octets, force=True)


def written_units(folder: Path) -> list[Path]:
    """Those in `folder` that `pqsec plugin install --systemd` wrote."""
    paths = [folder / f"{NAME}.{kind}" for kind in ("socket", "service")]
    first = _SOCKET.partition("\n")[0].encode()
    return [path for path in paths if path.is_file() and _files.read(path).startswith(first)]


def _quoted(path: str) -> str:
    """As systemd.service(5) reads it between double quotes."""
    for character in ("\\", '"', "%", "$"):
        path = path.replace(character, {"%": "%%", "$": "$$"}.get(character, f"\\{character}"))
    return path
