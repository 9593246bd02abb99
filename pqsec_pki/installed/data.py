"""Lists the files that pqsec made on this machine."""

from collections.abc import Iterable, Iterator, Mapping
from os.path import lexists
from pathlib import Path
from shlex import quote

from pqsec_pki._files import disk_errors, exists, is_folder
from pqsec_pki.enrolment import is_credential_store
from pqsec_pki.errors import FileError
from pqsec_pki.installed.program import Place
from pqsec_pki.keystore import SETTINGS
from pqsec_pki.plugin import AgentFolder, units_folder, written_units
from pqsec_pki.trial import cache_path
from pqsec_pki.vendors import files_of_plugins, installed_plugins

SYSTEM_UNITS = Path("/etc/systemd/system")
_SERVICE = (Path("/etc/pqsec"), Path("/var/lib/pqsec"))
"""The folders of examples/operations: the passphrase, and the user's home."""


def made_here(environment: Mapping[str, str], plugin: Path) -> Iterator[Place]:
    """The plugin in its folder, what a user's and the system's services have, and the cache."""
    yield from _plugins(plugin)
    agent = AgentFolder.of(environment).folder
    if lexists(agent):
        yield Place("agent", agent, f"pqsec agent stop, then rm -r {quote(str(agent))}")
    for unit in written_units(units_folder(environment)):
        yield Place("unit", unit, "pqsec plugin uninstall")
    for unit in sorted(SYSTEM_UNITS.glob("pqsec-*")):
        name, path = quote(unit.name), quote(str(unit))
        yield Place("unit", unit, f"systemctl disable --now {name}, then rm {path}")
    for folder in (cache_path().parent, *_SERVICE):
        if lexists(folder):
            what = "cache" if folder not in _SERVICE else "service"
            yield Place(what, folder, f"rm -r {quote(str(folder))}")


def kept_in(folders: Iterable[Path]) -> tuple[list[Place], list[FileError]]:
    """The keystores and robots' credentials that are `folders`, or in them; and errors for folders
    in them that cannot be read.

    FileError if one of `folders` cannot be read.
    """
    named = dict.fromkeys(each.absolute() for each in folders)
    below: set[Path] = set()
    for folder in named:
        with disk_errors(folder):
            below.update(each for each in folder.iterdir() if is_folder(each))
    found = [place for folder in named for place in _kept(folder)]
    closed: list[FileError] = []
    for folder in sorted(below.difference(named)):
        try:
            found += _kept(folder)
        except FileError as error:
            closed.append(error)
    return found, closed


def _plugins(folder: Path) -> Iterator[Place]:
    """Each library that a stack loads, with its stack, and the other files."""
    named = {each.file: each.title for each in installed_plugins(folder)}
    for path in files_of_plugins(folder):
        what = f"plugin, {named[path]}" if path in named else "plugin"
        yield Place(what, path, "pqsec plugin uninstall")


def _kept(folder: Path) -> Iterator[Place]:
    if exists(folder / SETTINGS):
        yield Place("keystore", folder, "removing it deletes the CA keys")
    if is_credential_store(folder):
        yield Place("credentials", folder, "removing it deletes the robot's keys")
