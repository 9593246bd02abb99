"""Units for systemd, which start the agent before the first participant needs it."""

import sys
from collections.abc import Mapping
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki._places import make_folders, refuse_outsiders
from pqsec_pki.errors import FileError

NAME = "pqsec-agent"
_SOCKET = """\
# Written by `pqsec plugin install --systemd`.
[Unit]
Description=Socket of the pqsec agent

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
    """The folder of this user's systemd units; FileError if there is no home folder."""
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
    """File -> content, of the socket and the service for this interpreter.

    ExistsError for existing files with other content, unless `force`.
    """
    service = _SERVICE.format(name=NAME, python=_quoted(sys.executable))
    texts = {f"{NAME}.socket": _SOCKET, f"{NAME}.service": service}
    units = {folder / name: text.encode() for name, text in texts.items()}
    for path, octets in units.items():
        if not (force or (_is_file(path) and _files.read(path) == octets)):
            _files.refuse_existing(path)
    return units


def write_units(units: Mapping[Path, bytes]) -> None:
    """Write the units. FileError if that fails, or if another user could change them."""
    for path, octets in units.items():
        with _files.disk_errors(path):
            refuse_outsiders([path], "systemd runs what is there", roots=True)
            make_folders(path.parent, 0o755)
            _files.write(path, octets, force=True)


def written_units(folder: Path) -> list[Path]:
    """The units in `folder` that `pqsec plugin install --systemd` wrote."""
    paths = [folder / f"{NAME}.{kind}" for kind in ("socket", "service")]
    first = _SOCKET.partition("\n")[0].encode()
    return [path for path in paths if _is_file(path) and _files.read(path).startswith(first)]


def _is_file(path: Path) -> bool:
    """Whether it is one; FileError if that cannot be known."""
    return _files.exists(path) and path.is_file()


def _quoted(path: str) -> str:
    """`text` as systemd.service(5) reads it between double quotes."""
    for character in ("\\", '"', "%", "$"):
        path = path.replace(character, {"%": "%%", "$": "$$"}.get(character, f"\\{character}"))
    return path
