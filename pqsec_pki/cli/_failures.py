"""Errors and hints on stderr: a line for each problem, or one line of JSON with --json."""

import json
import sys

import click

from pqsec_pki.cli._colour import on_terminal, painted
from pqsec_pki.cli._printing import JSON_VERSION, for_people
from pqsec_pki.cli._settings import CommandSettings
from pqsec_pki.errors import InvalidDocumentError, PqsecError, VerificationError
from pqsec_pki.problems import Problem


def is_json(settings: CommandSettings) -> bool:
    """Whether --json was given, also on a command line that could not be read."""
    return settings.json or "--json" in sys.argv[1:]


def print_error(error: PqsecError, *, as_json: bool) -> None:
    """Print what a room refused, with its hint."""
    if as_json:
        _print_json(_problems(error), error.exit_code, error.hint, error.where)
    else:
        print_messages(*error.lines, hint=error.hint)


def print_usage_error(error: click.ClickException, *, as_json: bool) -> None:
    """Print what is wrong with the command line."""
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        error.show()
        return
    context = error.ctx if isinstance(error, click.UsageError) else None
    command = context.command_path if context else "pqsec"
    is_group = context is None or isinstance(context.command, click.Group)
    what = "lists its commands" if is_group else "shows its arguments and options"
    hint = f"`{command} --help` {what}"
    if isinstance(error, click.NoSuchOption) and error.option_name == "--force":
        error = click.NoSuchOption(error.option_name, ctx=context)  # proposes none for it
        hint = f"this command replaces nothing: remove what is in its way; {hint}"
    message = " ".join(error.format_message().split())  # click lists choices below each other
    if as_json:
        _print_json((Problem(message),), error.exit_code, hint)
    else:
        print_messages(message, hint=hint)


def print_messages(*messages: str, hint: str | None = None) -> None:
    """Print lines for people."""
    for message in messages:
        _say("error", message)
    if hint:
        _say("hint", hint)


def _say(kind: str, text: str) -> None:
    line = f"pqsec: {kind}: {for_people(text)}"
    click.echo(painted(line) if on_terminal(sys.stderr) else line, err=True)


def _problems(error: PqsecError) -> tuple[Problem, ...]:
    if isinstance(error, InvalidDocumentError | VerificationError):
        return error.problems
    return (Problem(error.words, error.code),)


def _print_json(
    problems: tuple[Problem, ...], exit_code: int, hint: str | None, where: str | None = None
) -> None:
    errors = [
        {
            "message": each.message,
            "code": each.code,
            "subject": each.subject or where,
            "line": each.line,
            "element": each.element,
        }
        for each in problems
    ]
    value = {"version": JSON_VERSION, "errors": errors, "hint": hint, "exit_code": exit_code}
    click.echo(json.dumps(value), err=True)
