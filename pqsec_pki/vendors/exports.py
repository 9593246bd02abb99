"""An export: the files that a stack reads, and what to do with them."""

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path, PurePosixPath
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki._drafts import draft_folder, move_new
from pqsec_pki._files import (
    PRIVATE_MODE,
    PUBLIC_MODE,
    create,
    disk_errors,
    read,
    refuse_existing,
)
from pqsec_pki.credentials import KEYS
from pqsec_pki.errors import FileError, UsageError, shown
from pqsec_pki.stacks import Stack

FOLDER = "\0"
"""In steps and variables it is replaced by the absolute path of the export's folder. No path and no
name has this character."""
PASSWORD_VARIABLE = "PQSEC_KEY_PASSWORD"  # noqa: S105 -- a variable's name
"""The variable from which stacks read the passphrase of an encrypted key, if they can."""

UNFIT = re.compile("[\x00-\x1f\x7f\ud800-\udfff\ufffe\uffff]")
"""Characters that XML does not allow or a parser changes; a file's name may contain them."""

Version = tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """The options of an export."""

    version: str | None = None
    """The version of the stack, such as 3.1.2 or 3.1; None if not given."""
    loopback: bool = False
    """For tests on one machine: only 127.0.0.1, no multicast."""
    udp_only: bool = False
    """For tests on one machine: Fast DDS uses no shared memory, as between machines."""
    password: str | None = field(default=None, repr=False)
    """The passphrase of the participant's encrypted key, to be written unchanged into the file."""
    at: PurePosixPath | None = None
    """The enclave's folder on the machine that the export is for; None: where it is now."""
    plugins: Path | None = None
    """The folder with the security plugins, for stacks that load them by path."""
    plugin: Path | None = None
    """The folder with pqsec's own plugin, if that is to run instead of the stack's."""
    rmw: str | None = None
    """The middleware of ROS 2 that is to run our plugin; None: see `runs_in`."""
    crypto: Path | None = None
    """The stack's own plugin for encryption, if it is not in `plugins`, or our plugin runs."""
    stock: tuple[str, ...] | None = None
    """With our plugin and several sets of credentials: the names and patterns of participants that
    may be met with the first; None: those that `pqsec.toml` has."""
    anyway: bool = False
    """Whether to write an export that the stack is known to refuse, with a warning."""
    environment: Mapping[str, str] = field(default_factory=dict, repr=False)
    """The variables of the user's shell, for stacks that read them."""

    @property
    def runs_in(self) -> str:
        """The middleware of ROS 2 that runs our plugin: `rmw`, else that of the shell."""
        shell = "" if self.at else self.environment.get("RMW_IMPLEMENTATION", "")
        return self.rmw or ("fastrtps" if shell == "rmw_fastrtps_cpp" else Stack.CYCLONEDDS.value)

    @property
    def release(self) -> Version:
        """The version in numbers, () if none was given; UsageError for other text."""
        if self.version is None:
            return ()
        if not re.fullmatch(r"[0-9]{1,4}(\.[0-9]{1,4}){0,3}", self.version):
            raise UsageError(f"{self.version!r} is not a version", hint="write 3.1.2, or 3.1")
        return tuple(map(int, self.version.split(".")))


@dataclass(frozen=True, slots=True, kw_only=True)
class Export:
    """The files, variables and commands that one stack needs to run as one participant."""

    stack: str
    participant: str
    files: Mapping[str, str | Path] = field(repr=False)
    """Path below the export's folder -> its text, or the file of the keystore to copy there.
    The first is a text, the main file for the user."""
    environment: Mapping[str, str] = field(default_factory=dict)
    """Variables that the stack's process needs; FOLDER is replaced by the export's folder."""
    steps: tuple[str, ...] = ()
    """Shell commands to run after setting the variables; FOLDER is replaced too."""
    notes: tuple[str, ...] = ()
    """Notes for the user, a sentence each."""
    warnings: tuple[str, ...] = ()
    """Warnings: what may not work, or is a risk."""
    is_private: bool = False
    """Whether a secret is in a text: it is then written 0600."""
    unfit_folder: str = ""
    """Characters that the path of the export's folder may not have."""

    @property
    def main(self) -> str:
        """The name of the main file for the user."""
        return next(iter(self.files))

    def variables(self, folder: Path) -> dict[str, str]:
        """The environment for an export that is written to `folder`."""
        where = str(folder.absolute())
        return {name: value.replace(FOLDER, where) for name, value in self.environment.items()}

    def commands(self, folder: Path) -> list[str]:
        """The lines to type in a shell, for an export that is written to `folder`."""
        found = [f"export {k}={shlex.quote(v)}" for k, v in self.variables(folder).items()]
        where = shlex.quote(str(folder.absolute()))
        return found + [step.replace(FOLDER, where) for step in self.steps]

    def to_json(self, folder: Path | None = None, files: Sequence[Path] = ()) -> dict[str, Any]:
        """The export for --json; with `folder`, also the files that were written there."""
        value: dict[str, Any] = {
            "stack": self.stack,
            "participant": self.participant,
            "notes": self.notes,
            "warnings": self.warnings,
        }
        if folder:
            value["files"] = files
            value["environment"] = self.variables(folder)
            value["commands"] = self.commands(folder)
        return value


def write(export: Export, folder: Path, *, force: bool = False) -> list[Path]:
    """Write the export's files into `folder`, and return their paths.

    A new folder appears in one step. In an existing folder the files appear when all are
    written, and none is replaced without `force` (ExistsError). Copies of private keys and texts
    with a secret are 0600, and folders made for them 0700. FileError if writing fails,
    UsageError for a folder whose name the stack or a shell cannot use.
    """
    path = str(folder.absolute())
    if unfit := "".join(sorted(set(export.unfit_folder) & set(path) | set(UNFIT.findall(path)))):
        raise UsageError(
            f"{shown(path)}: the stack cannot use a folder with {unfit!r} in its name",
            hint="choose another folder",
        )
    with disk_errors(folder):
        there = os.path.lexists(folder)
        if not there:
            folder.parent.mkdir(parents=True, exist_ok=True)
        place = folder if there else folder.parent
        with disk_errors(folder, drafting=True), draft_folder(str(place)) as draft:
            _fill(Path(draft), export)
            with disk_errors(folder):
                if there:
                    _move(export, Path(draft), folder, force=force)
                else:
                    Path(draft).rename(folder)
    return [folder / name for name in export.files]


def _fill(draft: Path, export: Export) -> None:
    folders = {draft}
    for name, source in export.files.items():
        data = source.encode() if isinstance(source, str) else read(source)
        goal = draft / name
        goal.parent.mkdir(parents=True, exist_ok=True)
        folders.add(goal.parent)
        create(goal, data, mode=PRIVATE_MODE if _is_secret(export, source) else PUBLIC_MODE)
    for folder in folders:
        folder.chmod(_folder_mode(export))


def _move(export: Export, draft: Path, folder: Path, *, force: bool) -> None:
    goals = {draft / name: folder / name for name in export.files}
    for goal in goals.values():
        if not force:
            refuse_existing(goal)
        elif goal.is_dir() and not goal.is_symlink():
            raise FileError(f"{goal}: a folder is in its place")
    for goal in goals.values():
        goal.parent.mkdir(mode=_folder_mode(export), parents=True, exist_ok=True)
    for new, goal in goals.items():
        if force:
            new.replace(goal)
        else:
            move_new(new, goal)  # replaces no file that was created in the meantime


def _is_secret(export: Export, source: str | Path) -> bool:
    return export.is_private if isinstance(source, str) else source.name in KEYS


def _folder_mode(export: Export) -> int:
    private = any(_is_secret(export, source) for source in export.files.values())
    return 0o700 if private else 0o755
