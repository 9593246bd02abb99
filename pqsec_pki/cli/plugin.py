"""pqsec plugin: the security plugin that Cyclone DDS loads."""

from pathlib import Path

import click

from pqsec_pki.cli import _common
from pqsec_pki.plugin import build

DEFAULT_FOLDER = Path("~/.local/lib/pqsec")


@click.group()
def plugin() -> None:
    """Install the security plugin that Cyclone DDS loads.

    It authenticates participants with post-quantum keys and decides what they may do;
    Cyclone DDS's own plugin goes on encrypting. The keys stay with `pqsec agent`.
    """


@plugin.command("install")
@click.option(
    "--dir",
    "folder",
    type=_common.FOLDER,
    help=f"Where to put it. [default: {DEFAULT_FOLDER}]",
)
@click.option("--force", is_flag=True, help="Replace what is there.")
@_common.command_options
def install(folder: Path | None, *, force: bool) -> None:
    """Compile the library for this machine, and try it.

    It needs a C compiler, and nothing of Cyclone DDS. Beside it are put two links by the
    names that ROS 2 loads.
    """
    built = build((folder or DEFAULT_FOLDER.expanduser()).absolute(), force=force)
    value = {"library": str(built.library), "links": [str(link) for link in built.links]}
    lines = [
        f"library   {built.library}",
        f"ROS 2     put {built.library.parent} first in LD_LIBRARY_PATH",
    ]
    _common.emit(value, lines)
