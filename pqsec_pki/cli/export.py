"""pqsec export: write the configuration of a DDS stack for a participant."""

import os
from pathlib import Path, PurePosixPath
from typing import Any

import click

from pqsec_pki.cli import _completion, _help, _passphrases, _printing, _settings
from pqsec_pki.cli.plugin import DEFAULT_FOLDER, default_folder
from pqsec_pki.errors import UsageError
from pqsec_pki.stacks import Stack, stack_named
from pqsec_pki.vendors import FASTRTPS, Export, Options, write
from pqsec_pki.vendors import export as make_export


@_help.command(
    examples={
        "Print the configuration for Cyclone DDS": "pqsec export cyclonedds /talker",
        "Write the configuration for Fast DDS into a folder": (
            "pqsec export fastdds /talker -o talker"
        ),
        "Write the configuration for ROS 2": "pqsec export ros2 /talker -o ros2-talker",
    },
    exit_codes={
        0: "the configuration is written",
        1: "the stack would refuse it: not written; with --anyway, written",
        3: "the keystore, participant or a file cannot be read or written",
    },
)
@click.argument("stack", type=click.Choice([each.value for each in Stack]), metavar="STACK")
@click.argument("name", shell_complete=_completion.participants)
@click.option(
    "-o",
    "--output",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Write the files into DIR. [default: print the first file]",
)
@click.option(
    "--stack-version",
    "version",
    metavar="VERSION",
    help="Write for this version of the stack, such as 3.1.2.",
)
@click.option("--loopback", is_flag=True, help="Use 127.0.0.1 only, for tests on one machine.")
@click.option(
    "--at",
    metavar="PATH",
    help="Write paths as if the participant's folder were at PATH, on the machine that runs it."
    " [default: where it is]",
)
@click.option(
    "--plugins",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Load Cyclone DDS's plugins from DIR; with --plugin, pqsec's plugin. [default with"
    f" --plugin: ~/{DEFAULT_FOLDER}]",
)
@click.option(
    "--crypto",
    type=_settings.FILE,
    metavar="FILE",
    help="Load Cyclone DDS's own plugin for encryption from FILE, also with --plugin. [default:"
    " search for it]",
)
@click.option(
    "--plugin",
    is_flag=True,
    help="Run pqsec's plugin in Cyclone DDS, Fast DDS or OpenDDS, for post-quantum keys.",
)
@click.option(
    "--rmw",
    type=click.Choice([Stack.CYCLONEDDS.value, FASTRTPS]),
    help="With ros2 and --plugin: run it in this middleware. [default: that of $RMW_IMPLEMENTATION,"
    " without one or for another machine cyclonedds]",
)
@click.option(
    "--password-file",
    type=_settings.FILE,
    help="Write the passphrase of the participant's key, the first line of this file, into the"
    " configuration. [default: the process reads $PQSEC_KEY_PASSWORD; not Fast DDS]",
)
@click.option(
    "--anyway", is_flag=True, help="Also write a configuration that the stack is known to refuse."
)
@click.option("--force", is_flag=True, help="Replace existing files.")
@_settings.command_options
def export(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    stack: str,
    name: str,
    output: Path | None,
    version: str | None,
    at: str | None,
    plugins: Path | None,
    crypto: Path | None,
    password_file: Path | None,
    rmw: str | None,
    *,
    plugin: bool,
    loopback: bool,
    anyway: bool,
    force: bool,
) -> None:
    """Write the configuration that a DDS stack needs to run as a participant.

    STACK is cyclonedds, fastdds, opendds, connext or ros2. NAME is a participant such as
    /talker. The files refer to the credentials where they are now. A configuration that the
    stack is known to refuse is not written; the reason is printed.
    """
    if plugin and at is not None and plugins is None:
        raise UsageError(
            "--at with --plugin needs --plugins",
            hint="name the plugin's folder on that machine: --plugins DIR, as in `pqsec plugin"
            " install --dir DIR`",
        )
    options = Options(
        version=version,
        loopback=loopback,
        password=_passphrases.of_key(password_file),
        at=PurePosixPath(at) if at is not None else None,
        plugins=None if plugin else plugins,
        plugin=(plugins or default_folder()) if plugin else None,
        rmw=rmw,
        crypto=crypto,
        anyway=anyway,
        environment=dict(os.environ),
    )
    keystore = _settings.open_keystore()
    made = make_export(stack_named(stack), keystore, name, options, now=_settings.now())
    if made.is_private and output is None:
        raise UsageError(
            "the configuration contains the passphrase and is not printed",
            hint="write it with -o DIR: only you can read the file",
        )
    written = write(made, output, force=force) if output else []
    for text in (*made.notes, *made.warnings):
        _printing.note(text)
    _print_export(made, output, written)


def _print_export(made: Export, output: Path | None, written: list[Path]) -> None:
    value: dict[str, Any] = {
        "stack": made.stack,
        "participant": made.participant,
        "notes": made.notes,
        "warnings": made.warnings,
    }
    if output:
        value |= {
            "files": written,
            "environment": made.variables(output),
            "commands": made.commands(output),
        }
        _printing.emit(value, [*map(str, written), "", "To use it:", *made.commands(output)])
        return
    texts = {path: each for path, each in made.files.items() if isinstance(each, str)}
    _printing.emit(value | {"texts": texts}, [texts[made.main].removesuffix("\n")], verbatim=True)
