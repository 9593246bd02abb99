"""Shared by commands: -k and --json, parameter types, and the clock."""

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import UNITS, duration
from pqsec_pki.errors import UsageError

if TYPE_CHECKING:
    from pqsec_pki.keystore import Keystore

Command = TypeVar("Command", bound=Callable[..., Any])

APPROVED = f"{__name__}.approved"
"""In a context's `meta`: whether people approved what its command does."""
KEYSTORE_VARIABLES = ("PQSEC_KEYSTORE", "ROS_SECURITY_KEYSTORE")


class _Path(click.Path):
    """A path that is not empty. click takes an empty path (an unset variable) as `.`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path. Raises click's error for an empty one."""
        if value == "":
            self.fail("the path is empty", param, ctx)
        return super().convert(value, param, ctx)


FILE = _Path(path_type=Path, dir_okay=False, readable=False)
PATH = _Path(path_type=Path, readable=False)
FOLDER = _Path(path_type=Path, file_okay=False, readable=False)


@dataclass(slots=True)
class CommandSettings:
    """The options that are accepted before and after the command."""

    keystore: Path | None = None
    json: bool = False


def settings(context: click.Context | None = None) -> CommandSettings:
    """The settings of the current command, or of that of `context`."""
    return (context or click.get_current_context()).find_root().ensure_object(CommandSettings)


def command_options(command: Command) -> Command:
    """Add -k and --json to a command or group."""

    def remember(context: click.Context, parameter: click.Parameter, value: object) -> None:
        if value:
            setattr(context.find_root().ensure_object(CommandSettings), str(parameter.name), value)

    keystore = click.option(
        "-k",
        "--keystore",
        metavar="DIR",
        type=FOLDER,
        expose_value=False,
        callback=remember,
        help=f"Use this keystore. [default: ${', then $'.join(KEYSTORE_VARIABLES)}]",
    )
    as_json = click.option(
        "--json",
        is_flag=True,
        expose_value=False,
        callback=remember,
        help="Print the result as JSON.",
    )
    return keystore(as_json(command))


def given_options() -> dict[str, str]:
    """The options on the command line: their parameters, and names such as --domain."""
    context = click.get_current_context()
    return {
        str(each.name): each.opts[0]
        for each in context.command.params
        if context.get_parameter_source(str(each.name)) is ParameterSource.COMMANDLINE
    }


def keystore_path(context: click.Context | None = None, *, instead: str = "") -> Path:
    """The path of the keystore. UsageError if none is named; its hint has also `instead`."""
    named = settings(context).keystore
    if named:
        return named
    for variable in KEYSTORE_VARIABLES:
        if found := os.environ.get(variable):
            return Path(found)
    from pqsec_pki.keystore import layout  # noqa: PLC0415 -- not for --help

    is_here = Path(layout.SETTINGS).exists()
    raise UsageError(
        "no keystore named",
        hint="the current folder is a keystore: use -k ."
        if is_here
        else f"name one: -k DIR, or set PQSEC_KEYSTORE{instead and f'; or give {instead}'}",
    )


def open_keystore(*, to_change: bool = False, instead: str = "") -> "Keystore":
    """Open the keystore; nothing in it is changed unless `to_change`.

    `instead` is what the command takes in place of a keystore.
    """
    from pqsec_pki.keystore import Keystore  # noqa: PLC0415 -- it imports lxml and more

    keystore = Keystore.open(keystore_path(instead=instead), to_change=to_change)
    if click.get_current_context().meta.get(APPROVED):
        return replace(keystore, approved=True)
    return keystore


def now() -> datetime:
    """The current time in UTC. Other rooms get the time as a parameter."""
    return datetime.now(UTC)


class Duration(click.ParamType):  # type: ignore[type-arg] # generic in newer clicks only
    """A validity such as 10y, 90d or 12h. A year has 365 days."""

    name = "duration"
    units: Mapping[str, timedelta] = UNITS
    examples = "10y, 26w, 90d or 12h"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> timedelta:
        """The duration. Raises click's error for anything else."""
        if isinstance(value, timedelta):
            return value
        found = duration(str(value), self.units)
        if found is None:
            self.fail(f"{value!r} is not a duration: write {self.examples}", param, ctx)
        return found


class WaitingTime(Duration):
    """The time for which a command waits, such as 90s, 5m or 12h."""

    units: Mapping[str, timedelta] = {
        **{unit: UNITS[unit] for unit in "hd"},
        "m": timedelta(minutes=1),
        "s": timedelta(seconds=1),
    }
    examples = "90s, 5m, 12h or 2d"


class FiniteRange(click.FloatRange):
    """A number in a range. NaN, which no comparison excludes, is not in it."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number. Raises click's error for anything else."""
        found = float(super().convert(value, param, ctx))
        if not isfinite(found):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return found


class Percent(click.ParamType):  # type: ignore[type-arg] # generic in newer clicks only
    """A loss such as 2 or 2%, as 0.02; at most half. Below 1 it needs the %: 0.02 may mean 2%."""

    name = "percent"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The share. Raises click's error for anything else."""
        if isinstance(value, float):
            return value
        try:
            share = float(str(value).removesuffix("%")) / 100
        except ValueError:
            share = -1.0
        if not 0 <= share <= 0.5:  # noqa: PLR2004 -- beyond, hardly a message of 15 datagrams arrives
            self.fail(f"{value!r} is not a loss from 0% to 50%", param, ctx)
        if 0 < share < 0.01 and not str(value).endswith("%"):  # noqa: PLR2004 -- one percent
            percent = f"{float(str(value)) * 100:g}%"
            self.fail(f"{value!r} is {percent} or {value}%: write one of them", param, ctx)
        return share


class When(click.ParamType):  # type: ignore[type-arg] # generic in newer clicks only
    """A date, a time (ISO 8601, local if it names no zone), or a duration from now or `ago`."""

    name = "when"

    def __init__(self, *, ago: bool = False) -> None:
        self._ago = ago

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> datetime:
        """The time, in UTC. Raises click's error for anything else."""
        if isinstance(value, datetime):
            return value
        with suppress(ValueError, OverflowError):
            return datetime.fromisoformat(str(value)).astimezone(UTC)
        try:
            length = Duration().convert(value, param, ctx)
            return now() - length if self._ago else now() + length
        except (click.BadParameter, OverflowError):
            self.fail(f"{value!r} is not a time: write 2027-01-31 or 90d", param, ctx)
