"""pqsec plugin: the security plugin that Cyclone DDS, Fast DDS and OpenDDS load."""

import os
from collections.abc import Iterator
from pathlib import Path
from shlex import quote

import click

from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.errors import UsageError
from pqsec_pki.plugin import build, home, units_folder, written_units
from pqsec_pki.stacks import Stack

DEFAULT_FOLDER = Path(".local/lib/pqsec")
"""In the user's home."""
CYCLONEDDS, FASTDDS = Stack.CYCLONEDDS.value, Stack.FASTDDS.value
OPENDDS = Stack.OPENDDS.value


def default_folder() -> Path:
    """The plugin's folder without an option; FileError if the user has no home."""
    return home() / DEFAULT_FOLDER


_START = (
    "systemctl --user daemon-reload",
    "systemctl --user enable --now pqsec-agent.service",
)
_STOP = "systemctl --user disable --now pqsec-agent.service pqsec-agent.socket"


@_help.group()
def plugin() -> None:
    """Install the security plugin that DDS stacks load.

    It authenticates participants with post-quantum keys and decides what they may do;
    the stack's own plugin goes on encrypting. The keys stay with `pqsec agent`.
    """


@plugin.command(
    "install",
    examples={
        "Install the plugin for Cyclone DDS in ~/.local/lib/pqsec": "pqsec plugin install",
        "Replace it, and let systemd start the agent at login": (
            "pqsec plugin install --force --systemd"
        ),
        "Install it for the Fast DDS of this machine": "pqsec plugin install fastdds",
        "Install it for the Fast DDS of a colcon workspace": (
            "pqsec plugin install fastdds --library install/fastdds/lib/libfastdds.so"
        ),
        "Install it for the OpenDDS in a folder": "pqsec plugin install opendds --root DIR",
    },
    exit_codes={
        0: "installed",
        3: "it cannot be compiled, it does not run in the stack, or a file exists or cannot be"
        " written",
    },
)
@click.argument(
    "stack",
    type=click.Choice([CYCLONEDDS, FASTDDS, OPENDDS]),
    default=CYCLONEDDS,
    metavar="[STACK]",
)
@click.option(
    "--dir",
    "folder",
    type=_settings.FOLDER,
    help=f"Put it in this folder. [default: ~/{DEFAULT_FOLDER}]",
)
@click.option(
    "--library",
    type=_settings.FILE,
    metavar="PATH",
    help="With fastdds: compile for this library. [default: the installed libfastrtps or"
    " libfastdds]",
)
@click.option(
    "--include",
    type=_settings.FOLDER,
    metavar="DIR",
    multiple=True,
    help="With fastdds: search this folder for headers of Fast DDS and Fast CDR. Repeatable."
    " [default: the folders of headers near the library]",
)
@click.option(
    "--root",
    type=_settings.FOLDER,
    metavar="DIR",
    help="With opendds: compile for the OpenDDS in this folder. [default: $DDS_ROOT]",
)
@click.option(
    "--systemd",
    is_flag=True,
    help="Also write units with which systemd runs an agent from login on.",
)
@click.option("--force", is_flag=True, help="Replace what is there.")
@_settings.command_options
def install(  # noqa: PLR0913 -- one for each option, by name
    stack: str,
    folder: Path | None,
    library: Path | None,
    include: tuple[Path, ...],
    root: Path | None,
    *,
    systemd: bool,
    force: bool,
) -> None:
    """Compile the plugin for this machine, and try it.

    STACK is cyclonedds, the default, fastdds or opendds. For Cyclone DDS it needs a C compiler,
    and also makes two links with the names that ROS 2 loads. For Fast DDS and OpenDDS it needs a
    C++ compiler and the headers of the stack, and is for that build of the stack only.
    """
    folder = (folder or default_folder()).absolute()
    if library and stack != FASTDDS:
        raise UsageError("--library is for fastdds", hint="with opendds, name its folder: --root")
    if include and stack != FASTDDS:
        raise UsageError("--include is for fastdds", hint="with opendds, name its folder: --root")
    if root and stack != OPENDDS:
        raise UsageError("--root is for opendds", hint="with fastdds, name the library: --library")
    if stack != CYCLONEDDS:
        if systemd:
            raise UsageError(f"--systemd is not for {stack}", hint="all stacks use one agent")
        if stack == FASTDDS:
            _install_fastdds(folder, library, include, force=force)
        else:
            _install_opendds(folder, root, force=force)
        return
    units = units_folder(os.environ) if systemd else None
    built = build(folder, units=units, force=force)
    lines = [
        f"library   {built.library}",
        f"ROS 2     put {built.library.parent} first in LD_LIBRARY_PATH",
    ]
    if built.units:
        lines += [f"systemd   {units}", "", *_START]
    _printing.emit(built.to_json(), lines)


def _install_fastdds(
    folder: Path, library: Path | None, include: tuple[Path, ...], *, force: bool
) -> None:
    from pqsec_pki.vendors import examine, find_fastdds  # noqa: PLC0415
    from pqsec_pki.vendors.fastdds_adapter import here  # noqa: PLC0415 -- for Fast DDS alone
    from pqsec_pki.vendors.fastdds_adapter import install as install_fastdds  # noqa: PLC0415

    stack = examine(library.absolute() if library else find_fastdds(), include=include)
    made = install_fastdds(stack, folder, here(), force=force)
    lines = [
        f"{stack.title}   {made.library}",
        f"preload   {made.preload}",
        "          set LD_PRELOAD to it, as `pqsec export fastdds NAME --plugin` says",
    ]
    _printing.emit(made.to_json(), lines)


def _install_opendds(folder: Path, root: Path | None, *, force: bool) -> None:
    from pqsec_pki.vendors import find_opendds, install_opendds  # noqa: PLC0415 -- for it alone
    from pqsec_pki.vendors.fastdds_adapter import here  # noqa: PLC0415 -- likewise

    stack = find_opendds(root, os.environ)
    made = install_opendds(stack, folder, here(), force=force)
    lines = [
        f"{stack.title}   {made.root}",
        f"adapter   {made.adapter}",
        "          your program loads it with the header of `pqsec export opendds NAME --plugin`;",
        f"          or put {made.first} first in LD_LIBRARY_PATH",
    ]
    _printing.emit(made.to_json(), lines)


@plugin.command(
    "status",
    examples={"List what is installed": "pqsec plugin status"},
    exit_codes={
        0: "all that is installed runs",
        1: "nothing is installed, or something must be installed again",
        3: "the folder cannot be read",
    },
)
@click.option(
    "--dir",
    "folder",
    type=_settings.FOLDER,
    help=f"The folder of the plugin. [default: ~/{DEFAULT_FOLDER}]",
)
@_settings.command_options
def status(folder: Path | None) -> int:
    """List what is installed, and for which library of which stack."""
    from pqsec_pki.vendors import InstalledPlugin, installed_plugins  # noqa: PLC0415

    folder = (folder or default_folder()).absolute()
    found = installed_plugins(folder)

    def lines() -> Iterator[str]:
        if not found:
            yield f"the plugin is not installed in {folder}"
        for each in found:
            yield f"{'FAIL' if each.problem else 'ok  '}  {each.title:<16}  {where(each)}"
            if each.problem:
                yield f"      {each.problem}: {each.remedy or install(each)}"

    def install(each: InstalledPlugin) -> str:
        return f"`pqsec plugin install {each.stack}`"

    def where(each: InstalledPlugin) -> str:
        return str(each.library or each.file)

    _printing.emit({"folder": folder, "installed": found}, lines())
    return 0 if found and not any(each.problem for each in found) else 1


@plugin.command(
    "uninstall",
    examples={"Remove the plugin for all stacks": "pqsec plugin uninstall --yes"},
    exit_codes={0: "removed, or not installed", 3: "a file cannot be removed"},
)
@click.option(
    "--dir",
    "folder",
    type=_settings.FOLDER,
    help=f"The folder of the plugin. [default: ~/{DEFAULT_FOLDER}]",
)
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@_settings.command_options
def uninstall(folder: Path | None, *, yes: bool) -> None:
    """Remove the plugin for all stacks, and the units for systemd.

    Participants with post-quantum keys are then refused by their stacks. The files are shown
    first.
    """
    from pqsec_pki._files import disk_errors  # noqa: PLC0415 -- not for `plugin install`
    from pqsec_pki.vendors import files_of_plugins, remove_plugins  # noqa: PLC0415 -- likewise

    folder = (folder or default_folder()).absolute()
    units = written_units(units_folder(os.environ))
    if not yes and (files := [*files_of_plugins(folder), *units]):
        confirm(
            lambda: _printing.emit(None, [f"remove: {path}" for path in files]),
            "Remove these?",
            what=f"{_printing.counted(len(files), 'file')} would be removed",
            hint="--yes removes them; `pqsec plugin status"
            f" --dir {quote(str(folder))}` lists what is installed",
        )
    removed = remove_plugins(folder)
    for unit in units:
        with disk_errors(unit):
            unit.unlink()
    lines = [f"removed   {path}" for path in (*removed, *units)]
    if units:
        lines += ["", _STOP]
    _printing.emit(
        {"removed": [*removed, *units]},
        lines or [f"the plugin is not installed in {folder}"],
    )
