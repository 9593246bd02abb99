"""The files of pqsec's plugin in a folder: what is installed for which stack, and removing it."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki._places import open_place
from pqsec_pki.plugin import LIBRARY, NAMES
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors.cyclone_plugins import in_words
from pqsec_pki.vendors.fastdds_adapter import ADAPTER, RECORD, installed
from pqsec_pki.vendors.opendds_adapter import OPENDDS_LINK, OPENDDS_RECORD, installed_opendds
from pqsec_pki.vendors.own_plugin import OPENDDS, PRELOAD


@dataclass(frozen=True, slots=True, kw_only=True)
class InstalledPlugin:
    """pqsec's plugin for one stack."""

    stack: Stack
    title: str
    """The stack, with its version if the plugin is for one version."""
    file: Path
    """The file that the stack loads."""
    library: Path | None = None
    """The library of the stack that it was compiled for; None if it is for any."""
    problem: str = ""
    """Why it does not run in that library, or should not; empty if it does."""
    remedy: str = ""
    """How to fix it, if it is not by another installation."""

    def to_json(self) -> dict[str, object]:
        """The plugin for --json."""
        return {
            "stack": self.stack,
            "title": self.title,
            "file": self.file,
            "library": self.library,
            "ok": not self.problem,
            "problem": self.problem or None,
        }


def installed_plugins(folder: Path) -> list[InstalledPlugin]:
    """The plugins in `folder`; FileError if it cannot be read."""
    with disk_errors(folder):
        found = list(_installed(folder))
    return [_guarded(each) for each in found]


def _guarded(plugin: InstalledPlugin) -> InstalledPlugin:
    """The same, with the problem that another user could change the file, if so."""
    if plugin.problem or not (found := open_place(plugin.file, roots=True)):
        return plugin
    words = f"{found.path}: {found.who}; anyone who may write there can change what processes load"
    return replace(plugin, problem=words, remedy=found.remedy)


def _installed(folder: Path) -> Iterator[InstalledPlugin]:
    if (folder / LIBRARY).is_file():
        yield InstalledPlugin(
            stack=Stack.CYCLONEDDS, title=Stack.CYCLONEDDS.product, file=folder / LIBRARY
        )
    missing = "" if (folder / PRELOAD).is_file() else f"{PRELOAD} is missing"
    for each in installed(folder):
        yield InstalledPlugin(
            stack=Stack.FASTDDS,
            title=f"{Stack.FASTDDS.product} {in_words(each.release)}",
            file=folder / PRELOAD,
            library=each.library,
            problem=missing or each.problem,
        )
    if found := installed_opendds(folder):
        yield InstalledPlugin(
            stack=Stack.OPENDDS,
            title=f"OpenDDS {in_words(found.release)}",
            file=folder / OPENDDS,
            library=found.library,
            problem=found.problem,
        )


def remove_plugins(folder: Path) -> list[Path]:
    """Remove all files of pqsec's plugin from `folder`, and the folder if that leaves it empty.

    Returns the removed files. Other files stay. FileError if removing is not allowed.
    """
    removed = files_of_plugins(folder)
    with disk_errors(folder):
        for path in removed:
            path.unlink()
        for each in ((folder / OPENDDS_LINK).parent, folder):
            with suppress(OSError):  # it has other files, or does not exist
                each.rmdir()
    return removed


def files_of_plugins(folder: Path) -> list[Path]:
    """All files of pqsec's plugin in `folder`. FileError if it cannot be read."""
    with disk_errors(folder):
        return list(_files_in(folder))


def _files_in(folder: Path) -> Iterator[Path]:
    for name in NAMES:
        path = folder / name
        if path.is_symlink() and path.readlink() == Path(LIBRARY):
            yield path
    link = folder / OPENDDS_LINK
    if link.is_symlink() and link.readlink() == Path("..", OPENDDS):
        yield link
    singles = (LIBRARY, PRELOAD, OPENDDS, OPENDDS_RECORD)
    for pattern in (*singles, ADAPTER.format("*"), RECORD.format("*")):
        yield from (path for path in sorted(folder.glob(pattern)) if path.is_file())
