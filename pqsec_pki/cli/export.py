"""pqsec export: write the configuration of a DDS stack for a participant."""

import os
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any

import click

from pqsec_pki.cli import _completion, _help, _passphrases, _printing, _settings
from pqsec_pki.cli._names import admitted
from pqsec_pki.cli.plugin import DEFAULT_FOLDER, default_folder
from pqsec_pki.errors import UsageError, located
from pqsec_pki.handshake import stock_name
from pqsec_pki.keystore import Keystore, is_several
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import FASTRTPS, Export, Options, exporter_of, write
from pqsec_pki.vendors import export as make_export


class _StackName(click.Choice):  # type: ignore[type-arg] # generic in newer clicks only
    """Also the name of another package's stack: `exporter_of` knows it, or refuses it."""

    def convert(self, value: str, *_: object) -> str:
        """The name as it is."""
        return value


class _Middleware(click.Choice):  # type: ignore[type-arg] # generic in newer clicks only
    """Also the name of its RMW package, as in RMW_IMPLEMENTATION."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The name of the stack; BadParameter for any other."""
        name = value.removeprefix("rmw_").removesuffix("_cpp")
        found: str = super().convert(name, param, ctx)
        return found


@_help.command(
    examples={
        "Print the configuration for Cyclone DDS": "pqsec export cyclonedds /talker",
        "Write the configuration for Fast DDS into a folder": (
            "pqsec export fastdds /talker -o talker"
        ),
        "Write the configuration for ROS 2": "pqsec export ros2 /talker -o ros2-talker",
        "Write one for each node of a robot that has its keys": (
            "pqsec export cyclonedds '/fleet/*' --at /etc/dds/current/enclaves -o robot"
        ),
    },
    exit_codes={
        0: "the configuration is written",
        1: "the stack would refuse it: not written; with --anyway, written",
        3: "the keystore, participant or a file cannot be read or written",
    },
)
@click.argument(
    "stack",
    type=_StackName([each.value for each in Stack]),
    metavar="STACK",
    shell_complete=_completion.stacks,
)
@click.argument(
    "names", nargs=-1, required=True, metavar="NAME...", shell_complete=_completion.participants
)
@click.option(
    "-o",
    "--output",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Write the files into DIR; of several participants, into DIR/NAME. [default: print the"
    " first file]",
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
    help="Write paths as if the participant's folder were at PATH, on the machine that runs it; of"
    " several, at PATH/NAME. [default: where it is]",
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
    "--stock",
    metavar="NAME",
    multiple=True,
    help="With --plugin and several sets of credentials: this participant, or those of a pattern"
    " ('/fleet/*'), may be met with the first set, as stock stacks are; all others are met with the"
    " strongest only. May be given several times. [default: those that pqsec.toml names, else"
    " nobody]",
)
@click.option(
    "--rmw",
    type=_Middleware([Stack.CYCLONEDDS.value, FASTRTPS]),
    help="With ros2 and --plugin: run it in this middleware, also rmw_fastrtps_cpp. [default: that"
    " of $RMW_IMPLEMENTATION, without one or for another machine cyclonedds]",
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
def export(
    stack: str,
    names: tuple[str, ...],
    output: Path | None,
    *,
    force: bool,
    **how: Any,
) -> None:
    """Write the configuration that a DDS stack needs to run as a participant.

    STACK is cyclonedds, fastdds, opendds, connext or ros2, or one that an installed package adds
    (entry point pqsec.exporters). NAME is a participant such as
    /talker, a pattern ('/robot1/*') or a group
    (@hall1). The files refer to the credentials where they are now. A
    configuration that the stack is known to refuse is not written; the reason is printed.
    """
    options = _options(**how)
    exporter_of(stack)  # an unknown one is refused before a keystore is looked for
    keystore, now = _settings.open_keystore(), _settings.now()
    if len(names) > 1 or any(map(is_several, names)):
        if output is None:
            raise UsageError("several participants need -o DIR")
        chosen = admitted(keystore, names)
        _print_all(_write_all(stack, keystore, chosen, options, output, now=now, force=force))
        return
    made = make_export(stack, keystore, names[0], options, now=now)
    if made.is_private and output is None:
        raise UsageError(
            "the configuration contains the passphrase and is not printed",
            hint="write it with -o DIR: only you can read the file",
        )
    written = write(made, output, force=force) if output else []
    for text in (*made.notes, *made.warnings):
        _printing.note(text)
    _print_export(made, output, written)


def _options(  # noqa: PLR0913 -- one for each option of the command
    *,
    version: str | None,
    at: str | None,
    plugins: Path | None,
    crypto: Path | None,
    password_file: Path | None,
    rmw: str | None,
    plugin: bool,
    stock: tuple[str, ...],
    loopback: bool,
    anyway: bool,
) -> Options:
    if stock and not plugin:
        raise UsageError("--stock is for --plugin", hint="a stock stack knows one set only")
    if plugin and at is not None and plugins is None:
        raise UsageError(
            "--at with --plugin needs --plugins",
            hint="name the plugin's folder on that machine: --plugins DIR, as in `pqsec plugin"
            " install --dir DIR`",
        )
    return Options(
        version=version,
        loopback=loopback,
        password=_passphrases.of_key(password_file),
        at=PurePosixPath(at) if at is not None else None,
        plugins=None if plugin else plugins,
        plugin=(plugins or default_folder()) if plugin else None,
        rmw=rmw,
        stock=tuple(map(stock_name, stock)) or None,
        crypto=crypto,
        anyway=anyway,
        environment=dict(os.environ),
    )


def _write_all(  # noqa: PLR0913 -- the options of the command
    stack: str,
    keystore: Keystore,
    names: Sequence[str],
    options: Options,
    output: Path,
    *,
    now: datetime,
    force: bool,
) -> list[dict[str, Any]]:
    """Write one configuration for each name, below its name; none if the stack refuses one."""
    made = []
    for name in names:
        own = replace(options, at=options.at / name.lstrip("/")) if options.at else options
        with located(name):
            made.append(make_export(stack, keystore, name, own, now=now))
    found = []
    for each in made:
        folder = output / each.participant.lstrip("/")
        written = write(each, folder, force=force)
        found.append(each.to_json(folder, written))
    return found


def _print_all(found: list[dict[str, Any]]) -> None:
    told: dict[str, list[str]] = {}
    for each in found:
        for text in (*each["notes"], *each["warnings"]):
            told.setdefault(text, []).append(each["participant"])
    for text, names in told.items():
        _printing.note(f"{_printing.few(names)}: {text}")
    _printing.emit({"exports": found}, [str(path) for each in found for path in each["files"]])


def _print_export(made: Export, output: Path | None, written: list[Path]) -> None:
    if output:
        value = made.to_json(output, written)
        _printing.emit(value, [*map(str, written), "", "To use it:", *made.commands(output)])
        return
    texts = {path: each for path, each in made.files.items() if isinstance(each, str)}
    _printing.emit(
        {**made.to_json(), "texts": texts}, [texts[made.main].removesuffix("\n")], verbatim=True
    )
