"""Commands with example command lines and exit codes in their help."""

from collections.abc import Callable, Mapping
from typing import Any

import click

USAGE = "wrong command line"
"""The meaning of exit code 2, which every command has."""
HELP_OPTIONS = ["-h", "--help"]
"""Also for code that inspects a single command: click keeps the option that is made first."""


class Command(click.Command):
    """A command whose help ends with examples and exit codes."""

    def __init__(
        self,
        *args: Any,
        examples: Mapping[str, str],
        exit_codes: Mapping[int, str],
        **settings: Any,
    ) -> None:
        """`examples`: what a command line does -> the command line. `exit_codes`: 2 may be left
        out, if it is the usual one.
        """
        super().__init__(*args, **settings)
        self.examples = dict(examples)
        self.exit_codes = dict(sorted({2: USAGE, **exit_codes}.items()))

    def get_help_option_names(self, ctx: click.Context) -> list[str]:
        """The same for every command, wherever it is in the tree."""
        del ctx
        return HELP_OPTIONS

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse like click; every usage error has its command, for the hint."""
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            error.ctx = error.ctx or ctx
            raise

    def get_short_help_str(self, limit: int = 45) -> str:
        """The first sentence, not shortened: a group's help wraps it."""
        del limit
        return " ".join((self.help or "").partition("\n\n")[0].split())

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples, each on one line so that it can be copied, and the exit codes."""
        del ctx
        with formatter.section("Examples"):
            for purpose, line in self.examples.items():
                formatter.write_text(f"{purpose}:")
                formatter.write(f"{'':{formatter.current_indent + 2}}{line}\n")
        with formatter.section("Exit codes"):
            formatter.write_dl([(str(code), words) for code, words in self.exit_codes.items()])


class Group(click.Group):
    """A group of such commands."""

    command_class = Command

    def get_help_option_names(self, ctx: click.Context) -> list[str]:
        """The same for every command, wherever it is in the tree."""
        del ctx
        return HELP_OPTIONS

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write where the examples and exit codes are."""
        formatter.write_paragraph()
        formatter.write_text(
            f"`{ctx.command_path} COMMAND --help` has the options, examples and exit codes."
        )


def command(
    name: str | None = None, *, examples: Mapping[str, str], exit_codes: Mapping[int, str]
) -> Callable[[Callable[..., Any]], Command]:
    """Make a function a command; see Command for the examples and exit codes."""
    return click.command(name, cls=Command, examples=examples, exit_codes=exit_codes)


def group(name: str | None = None) -> Callable[[Callable[..., Any]], Group]:
    """Make a function a group of commands."""
    return click.group(name, cls=Group)
