"""Writes docs/man/: each command's manual page, from its help. `python tests/docs/man_pages.py`.

It also writes the generated pages of docs/reference (reference_pages.py): one has all help texts.

The pages are in the repository, so that building a wheel needs no more than hatchling;
tests/docs/test_man_pages.py compares them with the code.
"""

import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))

import click  # noqa: E402 -- after the path

from pqsec_pki.cli import COMMANDS, GROUPS, pqsec  # noqa: E402
from tests.docs import reference_pages  # noqa: E402

FOLDER = ROOT / "docs/man"
ENVIRONMENT = {
    "PQSEC_KEYSTORE": "The keystore, if -k does not name one.",
    "ROS_SECURITY_KEYSTORE": "The keystore, if neither -k nor PQSEC_KEYSTORE names one.",
    "PQSEC_PASSPHRASE_FILE": "The file with the CA passphrase, if --passphrase-file names none.",
    "PQSEC_PIN_FILE": "The file with the PIN of the tokens, for keys whose URIs name no file.",
    "PQSEC_OPERATOR": "The name for the ledger.  [default: the system's name of the user]",
    "PQSEC_PKCS11_MODULE": "The library of the tokens.  [default: p11-kit's]",
}
EXIT_CODES = {
    0: "done, or yes",
    1: "checked, and the answer is no",
    2: "wrong command line",
    3: "failed: a file, keystore, participant or passphrase is missing or wrong",
}
_SPECIAL = {"\\": r"\e", "|": r"|\:", "-": r"\-", "'": r"\(aq", "^": r"\(ha", "~": r"\(ti"}


def pages() -> dict[str, str]:
    """The text of each page by its file name, such as `pqsec-ca-init.1`."""
    return dict(_pages_of(pqsec, ("pqsec",)))


def _pages_of(command: click.Command, path: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    yield f"{'-'.join(path)}.1", "\n".join(_page(command, path)) + "\n"
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner
            yield from _pages_of(inner, (*path, name))


def _page(command: click.Command, path: tuple[str, ...]) -> Iterator[str]:
    names = pqsec.context_settings["help_option_names"]
    context = click.Context(command, info_name=" ".join(path), help_option_names=names)
    first, *paragraphs = inspect.cleandoc(command.help or "").split("\n\n")
    title = "-".join(path)
    yield f'.TH "{title.upper()}" 1 "" "pqsec" "pqsec manual"'
    yield from (".nh", ".ad l")  # no option is hyphenated
    yield from (".SH NAME", rf"{_text(title)} \- {_text(_lowered(first))}")
    usage = " ".join(command.collect_usage_pieces(context))
    yield from (".SH SYNOPSIS", rf"\fB{_text(' '.join(path))}\fR {_text(usage)}", ".SH DESCRIPTION")
    yield _text(first)
    for paragraph in paragraphs:
        yield from (".PP", _text(paragraph))
    yield ".SH OPTIONS"
    for option in command.get_params(context):
        if isinstance(option, click.Option) and (record := option.get_help_record(context)):
            yield from _item(*record)
    if isinstance(command, click.Group):
        yield from _commands(command)
    yield from _examples(getattr(command, "examples", {}))
    yield ".SH EXIT STATUS"
    for code, meaning in getattr(command, "exit_codes", EXIT_CODES).items():
        yield from _item(str(code), meaning)
    yield ".SH ENVIRONMENT"
    for name, meaning in ENVIRONMENT.items():
        yield from _item(name, meaning)
    if len(path) > 1:
        yield from (".SH SEE ALSO", rf"\fB{_text('-'.join(path[:-1]))}\fR(1)")


def _commands(group: click.Group) -> Iterator[str]:
    context = click.Context(group)
    names = group.list_commands(context)
    headings = GROUPS if group is pqsec else {"Commands": " ".join(names)}
    for heading, inside in headings.items():
        yield f".SH {_text(heading.upper())}"
        for name in inside.split():
            command = group.get_command(context, name)
            assert command
            short = COMMANDS[name][1] if group is pqsec else command.get_short_help_str(limit=200)
            yield from _item(name, short)


def _examples(examples: dict[str, str]) -> Iterator[str]:
    if examples:
        yield ".SH EXAMPLES"
    for purpose, line in examples.items():
        yield from (".PP", f"{_text(purpose)}:", ".PP", ".nf", ".RS 4", _text(line), ".RE", ".fi")


def _item(term: str, text: str) -> tuple[str, ...]:
    return ".TP", rf"\fB{_text(term)}\fR", _text(text)


def _lowered(text: str) -> str:
    """As `man -k` prints it."""
    text = " ".join(text.split()).removesuffix(".")
    return text[0].lower() + text[1:]


def _text(text: str) -> str:
    """One line for troff: special characters escaped, `code` in bold, and no request at the start.

    A hyphen would be printed as another character, which cannot be copied into a shell.
    """
    escaped = "".join(_SPECIAL.get(each, each) for each in " ".join(text.split()))
    bold = re.sub(r"`([^`]*)`", r"\\fB\1\\fR", escaped).replace("`", r"\(ga")
    return rf"\&{bold}" if bold.startswith(".") else bold


def main() -> None:
    """Write all pages, and remove those of commands that no longer exist."""
    found = pages()
    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.iterdir():
        if path.name not in found:
            path.unlink()
    for name, text in found.items():
        (FOLDER / name).write_text(text)
    reference_pages.main()


if __name__ == "__main__":
    main()
