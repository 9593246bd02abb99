"""The pages of the site that are made from the code: one for each command and each rule."""

import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from pqsec_pki.cli import GROUPS, pqsec

COMMANDS = "reference/commands"
RULES = "reference/rules"
_RULE = re.compile(r"(?ms)^### ((PQS[0-9]{3}): .*?)$(.*?)(?=^##|\Z)")
_ID = re.compile(r"\bPQS[0-9]{3}\b")


def commands() -> dict[str, click.Command]:
    """Each command by its words, such as `ca init`, in the order of `pqsec --help`."""
    return dict(_commands_of(pqsec, [name for names in GROUPS.values() for name in names.split()]))


def _commands_of(
    group: click.Group, names: list[str], path: str = ""
) -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in names:
        command = group.get_command(context, name)
        assert command is not None, name  # noqa: S101 -- GROUPS names commands
        if isinstance(command, click.Group):
            yield from _commands_of(command, command.list_commands(context), f"{path}{name} ")
        else:
            yield f"{path}{name}", command


def command_pages() -> dict[str, str]:
    """The Markdown of each command's page, and of their index, by the page's path in the site."""
    found = commands()
    pages = {command_path(name): command_page(name, each) for name, each in found.items()}
    about = "[The command line](../commands.md) has what is common to all of them."
    index = command_index(lambda name: Path(command_path(name)).name)
    return {f"{COMMANDS}/index.md": "\n\n".join(["# Commands", about, *index]) + "\n"} | pages


def command_path(name: str) -> str:
    """The path of a command's page: reference/commands/ca-init.md for `ca init`."""
    return f"{COMMANDS}/{name.replace(' ', '-')}.md"


def command_page(name: str, command: click.Command) -> str:
    """What `pqsec NAME --help` says, as a page."""
    return re.sub(r"(?m)^#(#+ )", r"\1", command_section(name, command)) + "\n"


def command_section(name: str, command: click.Command) -> str:
    """What `pqsec NAME --help` says, as a section of level 2."""
    context = click.Context(command, info_name=f"pqsec {name}")
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    options = [
        record
        for parameter in command.get_params(context)
        if isinstance(parameter, click.Option) and (record := parameter.get_help_record(context))
    ]
    parts = [f"## pqsec {name}", *_paragraphs(command.help or ""), "### Usage", _block(usage)]
    parts += ["### Options", "\n".join(f"- `{option}`: {_plain(text)}" for option, text in options)]
    if examples := getattr(command, "examples", None):
        lines = "\n\n".join(f"# {purpose}\n{line}" for purpose, line in examples.items())
        parts += ["### Examples", _block(lines, "sh")]
    if codes := getattr(command, "exit_codes", None):
        rows = (f"| {code} | {_plain(words)} |" for code, words in codes.items())
        parts += ["### Exit codes", "\n".join(["| Code | Meaning |", "|---|---|", *rows])]
    return "\n\n".join(parts)


def command_index(link: Callable[[str], str]) -> Iterator[str]:
    """A table of commands for each group of `pqsec --help`, each with a link to `link(name)`."""
    found = commands()
    for heading, names in GROUPS.items():
        rows = (
            f"| [`pqsec {name}`]({link(name)}) | {_plain(command.get_short_help_str(limit=200))} |"
            for name, command in found.items()
            if name.split()[0] in names.split()
        )
        yield from (f"## {heading}", "\n".join(["| Command | Purpose |", "|---|---|", *rows]))


def _paragraphs(text: str) -> Iterator[str]:
    """Paragraphs of a click help text: those after `\\b` keep their lines."""
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        if paragraph.startswith("\b\n"):
            yield _block(paragraph.removeprefix("\b\n"))
        else:
            yield _plain(paragraph)


def _block(text: str, language: str = "text") -> str:
    return f"```{language}\n{text}\n```"


def _plain(text: str) -> str:
    """With characters that Markdown interprets escaped, except in `code`."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else _escaped(part) for part in parts)


def _escaped(text: str) -> str:
    return re.sub(r"([\\*_\[\]|])", r"\\\1", text).replace("<", "&lt;")


def rule_pages(rules: str) -> dict[str, str]:
    """The Markdown of each rule's page, by its path in the site; `rules` is the page of all."""
    return {
        f"{RULES}/{id_}.md": f"# {title}\n{text.rstrip()}\n"
        for title, id_, text in _RULE.findall(_for_mkdocs(rules))
    }


def rule_index(rules: str) -> str:
    """The page of all rules, with links to their pages in place of their texts."""

    def listed(found: re.Match[str]) -> str:
        severity = re.match(r"\s*\*\*(\w+)\*\*", found[3])
        return f"- [{found[1]}](rules/{found[2]}.md){f' ({severity[1]})' if severity else ''}\n"

    def linked(row: re.Match[str]) -> str:
        return _ID.sub(lambda id_: f"[{id_[0]}](rules/{id_[0]}.md)", row[0])

    return re.sub(r"(?m)^\|.*$", linked, _RULE.sub(listed, _for_mkdocs(rules)))


def _for_mkdocs(text: str) -> str:
    """Its Markdown does not take a backslash before `<`, which code hosts do."""
    return text.replace(r"\<", "&lt;")
