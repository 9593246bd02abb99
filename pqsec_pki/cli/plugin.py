"""pqsec plugin: the security plugin that Cyclone DDS loads."""

import os
from pathlib import Path

import click

from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.plugin import build, home, units_folder

DEFAULT_FOLDER = Path(".local/lib/pqsec")
"""In the user's home."""


def default_folder() -> Path:
    """Where the plugin is unless said otherwise; FileError if the user has no home."""
    return home() / DEFAULT_FOLDER


_START = (
    "systemctl --user daemon-reload",
    "systemctl --user enable --now pqsec-agent.service",
)


@_help.group()
def plugin() -> None:
    """Install the security plugin that Cyclone DDS loads.

    It authenticates participants with post-quantum keys and decides what they may do;
    Cyclone DDS's own plugin goes on encrypting. The keys stay with `pqsec agent`.
    """


@plugin.command(
    "install",
    examples={
        "Install the plugin in ~/.local/lib/pqsec": "pqsec plugin install",
        "Replace it, and let systemd start the agent at login": (
            "pqsec plugin install --force --systemd"
        ),
    },
    exit_codes={
        0: "installed",
        3: "it cannot be compiled, its test fails, or a file exists or cannot be written",
    },
)
@click.option(
    "--dir",
    "folder",
    type=_settings.FOLDER,
    help=f"Where to put it. [default: ~/{DEFAULT_FOLDER}]",
)
@click.option(
    "--systemd",
    is_flag=True,
    help="Write units too, with which systemd keeps an agent from login on.",
)
@click.option("--force", is_flag=True, help="Replace what is there.")
@_settings.command_options
def install(folder: Path | None, *, systemd: bool, force: bool) -> None:
    """Compile the library for this machine, and try it.

    It needs a C compiler, and nothing of Cyclone DDS. Beside it are put two links by the
    names that ROS 2 loads.
    """
    units = units_folder(os.environ) if systemd else None
    built = build((folder or default_folder()).absolute(), units=units, force=force)
    value = {"library": str(built.library), "links": [str(link) for link in built.links]}
    lines = [
        f"library   {built.library}",
        f"ROS 2     put {built.library.parent} first in LD_LIBRARY_PATH",
    ]
    if built.units:
        value["units"] = [str(unit) for unit in built.units]
        lines += [f"systemd   {units}", "", *_START]
    _printing.emit(value, lines)
