"""The options of commands that plan a migration: its target, and the robots' stacks."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from pqsec_pki import domain
from pqsec_pki.algorithms import PROFILES
from pqsec_pki.cli import _completion
from pqsec_pki.cli._settings import Command
from pqsec_pki.selfcheck import STACKS, SimulatedStack, stack_named

_STOCK = [each.name for each in STACKS if each.is_stock]


def target(flag: str, **settings: Any) -> Callable[[Command], Command]:
    """The option `flag` for the profile to change to, as `target`."""
    names = [each.name for each in PROFILES]
    return click.option(flag, "target", type=click.Choice(names), **settings)


stacks = click.option(
    "--stack",
    "stacks",
    multiple=True,
    type=click.Choice(_STOCK),
    help="Plan for robots with this stack. Repeatable. [default: those of the domain file, or all]",
    shell_complete=_completion.among(_STOCK),
)


def chosen(names: Sequence[str], file: Path | None) -> tuple[SimulatedStack, ...]:
    """The stacks `names`, else those that the domain.yaml `file` names, else all."""
    told = domain.read_domain(file).stacks if file else ()
    return tuple(stack_named(each) for each in names or told or _STOCK)
