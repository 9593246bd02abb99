"""What every command shares: -k and --json, where results go, and reading passphrases."""

import json
import os
import re
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from pqsec_pki.errors import FileError, PassphraseError, UsageError, shown

if TYPE_CHECKING:
    from pqsec_pki.keystore import Authorities, Keystore

Command = TypeVar("Command", bound=Callable[..., Any])

KEYSTORE_VARIABLES = ("PQSEC_KEYSTORE", "ROS_SECURITY_KEYSTORE")
PASSPHRASE_VARIABLE = "PQSEC_PASSPHRASE_FILE"  # noqa: S105 -- a variable's name
MAX_PASSPHRASE = 4096
"""Bytes."""


class _Path(click.Path):
    """A path; click takes the empty one, as of a variable that is not set, for `.`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; click's own error for an empty one."""
        if value == "":
            self.fail("it is empty", param, ctx)
        return super().convert(value, param, ctx)


FILE = _Path(path_type=Path, dir_okay=False, readable=False)
FOLDER = _Path(path_type=Path, file_okay=False, readable=False)


@dataclass(slots=True)
class Settings:
    """The options that are taken before or after the command."""

    keystore: Path | None = None
    json: bool = False


def settings() -> Settings:
    """The settings of the command that runs."""
    return click.get_current_context().find_root().ensure_object(Settings)


def command_options(command: Command) -> Command:
    """Add -k and --json to a command or group."""

    def remember(context: click.Context, parameter: click.Parameter, value: object) -> None:
        if value:
            setattr(context.find_root().ensure_object(Settings), str(parameter.name), value)

    keystore = click.option(
        "-k",
        "--keystore",
        metavar="DIR",
        type=FOLDER,
        expose_value=False,
        callback=remember,
        help=f"The keystore; else ${' or $'.join(KEYSTORE_VARIABLES)}.",
    )
    as_json = click.option(
        "--json",
        is_flag=True,
        expose_value=False,
        callback=remember,
        help="Print the result as JSON.",
    )
    return keystore(as_json(command))


def keystore_path() -> Path:
    """The keystore the user means; UsageError if none is named."""
    named = settings().keystore
    if named:
        return named
    for variable in KEYSTORE_VARIABLES:
        if found := os.environ.get(variable):
            return Path(found)
    raise UsageError("no keystore is named", hint="say which: -k DIR, or set PQSEC_KEYSTORE")


def open_keystore() -> "Keystore":
    """The keystore the user means, open."""
    from pqsec_pki.keystore import Keystore  # noqa: PLC0415 -- lxml and more hang on it

    return Keystore.open(keystore_path())


def unlock(keystore: "Keystore", passphrase_file: Path | None) -> "Authorities":
    """The keystore's CAs; the passphrase from the file, or asked for at a terminal."""
    if not keystore.is_locked:
        return keystore.unlock(None)
    if passphrase_file:
        return keystore.unlock(read_passphrase(passphrase_file))
    if not sys.stdin.isatty():
        raise UsageError(
            "the CA keys are encrypted, and there is no terminal to ask for the passphrase",
            hint=f"use --passphrase-file FILE, or set {PASSPHRASE_VARIABLE}",
        )
    return keystore.unlock(_asked("CA passphrase"))


def new_passphrase(
    passphrase_file: Path | None, *, none: bool, option: str = "--passphrase-file"
) -> bytes | None:
    """The passphrase for new CA keys; None only if the user says so."""
    if none and passphrase_file:
        raise UsageError(f"{option} and --no-passphrase exclude each other")
    if none:
        return None
    if passphrase_file:
        return read_passphrase(passphrase_file)
    if not sys.stdin.isatty():
        raise UsageError(
            "the CA keys need a passphrase, and there is no terminal to ask for one",
            hint=f"use {option} FILE, or --no-passphrase to leave them unencrypted",
        )
    return _asked("New CA passphrase", twice=True)


def _asked(what: str, *, twice: bool = False) -> bytes:
    try:
        answer: str = click.prompt(what, hide_input=True, confirmation_prompt=twice, err=True)
        return answer.encode()
    except UnicodeError:
        raise PassphraseError("the passphrase is not in the terminal's encoding") from None


def read_passphrase(path: Path) -> bytes:
    """The first line of the file, without its line end; PassphraseError if it is empty."""
    from pqsec_pki._files import read  # noqa: PLC0415 -- not for every command

    with suppress(OSError):  # what is wrong with the path, reading it tells
        if path.stat().st_mode & 0o077:
            note(f"{path} can be read by others: chmod 600 it")
    passphrase = read(path, limit=MAX_PASSPHRASE).split(b"\n", 1)[0].rstrip(b"\r")
    if not passphrase:
        raise PassphraseError(f"{path}: no passphrase in its first line")
    return passphrase


def key_password(path: Path | None) -> str | None:
    """The passphrase of a participant's key, as stacks take it; None without a file."""
    if path is None:
        return None
    try:
        return read_passphrase(path).decode()
    except UnicodeDecodeError:
        raise PassphraseError(f"{path}: the passphrase is not UTF-8") from None


def passphrase_option(command: Command) -> Command:
    """Add --passphrase-file to a command that uses CA keys."""
    option = click.option(
        "--passphrase-file",
        type=FILE,
        envvar=PASSPHRASE_VARIABLE,
        help="A file whose first line is the CA passphrase.",
    )
    return option(command)


def emit(value: object, lines: Iterable[str]) -> None:
    """Print the result: `value` as JSON, or `lines` for a person. FileError on a full disk."""
    try:
        for line in [json.dumps(value, indent=2)] if settings().json else lines:
            click.echo(line)
    except OSError as error:
        # Python flushes again as it ends; what is left of the result goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        reason = (error.strerror or str(error)).lower()
        raise FileError(f"the result cannot be printed: {reason}") from error


def note(text: str) -> None:
    """Tell the user something that is not the result."""
    click.echo(f"pqsec: note: {printable(text)}", err=True)


def printable(text: str) -> str:
    """`text` without what a terminal would obey: names of files are anybody's choice."""
    return shown(text, len(text))


def now() -> datetime:
    """The time, in UTC. Rooms have no clock of their own."""
    return datetime.now(UTC)


_UNITS = {"y": timedelta(365), "w": timedelta(7), "d": timedelta(1), "h": timedelta(hours=1)}


class Duration(click.ParamType):  # type: ignore[type-arg] # generic in newer clicks only
    """A validity such as 10y, 90d or 12h. A year has 365 days."""

    name = "duration"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> timedelta:
        """The duration; click's own error for anything else."""
        if isinstance(value, timedelta):
            return value
        found = re.fullmatch(r"([1-9][0-9]{0,5})([ywdh])", str(value))
        if not found:
            self.fail(f"{value!r} is not a duration; write 10y, 26w, 90d or 12h", param, ctx)
        return int(found[1]) * _UNITS[found[2]]


def table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    """The lines of a table with columns as wide as they must be."""
    grid = [heads, *rows]
    widths = [max(len(row[column]) for row in grid) for column in range(len(heads))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in grid
    ]
