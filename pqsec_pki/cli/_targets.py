"""The option --target: the stacks for which something is judged."""

from collections.abc import Callable
from typing import Any, TypeVar

import click

from pqsec_pki.cli import _completion
from pqsec_pki.stacks import Stack, stack_named

Command = TypeVar("Command", bound=Callable[..., Any])


class _Targets(click.ParamType):  # type: ignore[type-arg] # generic in newer clicks only
    """Names of stacks, separated by commas."""

    name = "targets"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[Stack, ...]:
        """The targets. Raises click's error for an unknown one."""
        if isinstance(value, tuple):
            return value
        words = [word.strip().lower() for word in str(value).split(",")]
        for word in words:
            if word not in set(Stack):
                self.fail(f"{word!r} is not one of {', '.join(Stack)}", param, ctx)
        return tuple(map(stack_named, words))


def option(what: str) -> Callable[[Command], Command]:
    """The option of a command, which does `what` for the stacks."""
    return click.option(
        "--target",
        "targets",
        type=_Targets(),
        default=(),
        metavar="STACK,...",
        help=f"{what}: {', '.join(Stack)}.",
        shell_complete=_completion.among(Stack),
    )
