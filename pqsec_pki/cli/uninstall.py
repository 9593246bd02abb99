"""pqsec uninstall: what pqsec has on this machine."""

import os
from contextlib import suppress
from pathlib import Path

import click

from pqsec_pki._files import disk_errors, exists
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.cli.plugin import default_folder
from pqsec_pki.errors import FileError, UsageError


@_help.command(
    examples={
        "List what pqsec has on this machine, and how to remove it": "pqsec uninstall --list",
        "Look for keystores and credentials in a folder too": "pqsec uninstall --list robots",
    },
    exit_codes={0: "listed", 3: "a folder or file cannot be read"},
)
@click.argument("folders", nargs=-1, type=_settings.FOLDER, metavar="[FOLDER]...")
@click.option("--list", "listed", is_flag=True, help="Show what is where. Nothing is removed.")
@_settings.command_options
def uninstall(folders: tuple[Path, ...], *, listed: bool) -> None:
    """List what pqsec has on this machine, and how each is removed.

    It looks for keystores and credentials in the current folder, in those of -k and its
    variables, and in each FOLDER, and one folder deeper.
    """
    from pqsec_pki.installed import kept_in, made_here, programs  # noqa: PLC0415 -- not for its help

    if not listed:
        raise UsageError("pqsec does not remove itself", hint="--list shows what is where")
    kept, closed = kept_in((Path.cwd(), *_keystores(), *folders))
    with disk_errors(Path.cwd()):  # of a home that is another user's, as after `sudo -E`
        found = [*programs(os.environ), *made_here(os.environ, default_folder()), *kept]
    rows = (
        (each.what, f"{each.path}:{each.line}" if each.line else str(each.path), each.removed_by)
        for each in found
    )
    _printing.emit({"places": found}, _printing.table(("WHAT", "WHERE", "REMOVED BY"), rows))
    for each in closed:
        _printing.note(f"not in the list: {each}")
    if closed:
        raise FileError(
            "the list is incomplete: a folder cannot be read",
            hint="the notes above name each folder",
        )


def _keystores() -> list[Path]:
    """The keystore that an option or a variable names, as for other commands."""
    with suppress(UsageError):
        path = _settings.keystore_path()
        return [path] if exists(path) else []
    return []
