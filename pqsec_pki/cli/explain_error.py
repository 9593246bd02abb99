"""pqsec explain-error: explain a stack's security error, and how to fix it."""

import sys
from collections import Counter
from collections.abc import Iterator

import click

from pqsec_pki.cli import _help, _pager, _printing, _settings
from pqsec_pki.cli._paragraph import paragraph
from pqsec_pki.errors import FileError, UsageError
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors.messages import Message, Recognised, messages, nearest, recognise

MAX_LOG = 16 << 20
"""Bytes. A log of a day of errors is smaller."""
MOST_ALIKE = 3
"""The most explanations of one message with different values, such as many peers."""
STACKS = [each.value for each in Stack if each is not Stack.CONNEXT]
"""The stacks whose messages pqsec knows."""


@_help.command(
    "explain-error",
    examples={
        "Explain an error code of Cyclone DDS": "pqsec explain-error 146",
        "Explain an error message": "pqsec explain-error 'Subject name is invalid(code: 146)'",
        "Explain all known messages in a log": "pqsec explain-error - < node.log",
    },
    exit_codes={
        0: "a message is known",
        1: "no message is known",
        3: "standard input cannot be read",
    },
)
@click.argument("text", nargs=-1, metavar="TEXT|CODE|-")
@click.option("--stack", type=click.Choice(STACKS), help="Recognise only messages of this stack.")
@click.option("--list", "as_list", is_flag=True, help="List all known messages.")
@_pager.option
@_settings.command_options
def explain_error(text: tuple[str, ...], stack: str | None, *, as_list: bool) -> None:
    """Explain a security error of a DDS stack, and how to fix it.

    TEXT is an error message. CODE is an error code of Cyclone DDS. With -, a whole log is
    read from standard input.
    """
    if as_list:
        if text:
            raise UsageError("--list and TEXT exclude each other")
        rows = messages(stack)
        _printing.emit({"messages": rows}, _list(rows))
        return
    words = _given(text)
    found = recognise(words, stack=stack)
    near = () if found else nearest(words, stack=stack)
    value = {"known": found, "nearest": near}
    _printing.emit(value, _lines(found, near, in_log="\n" in words.strip()))
    if not found:
        click.get_current_context().exit(1)


def _given(text: tuple[str, ...]) -> str:
    words = _standard_input() if text == ("-",) else " ".join(text)
    if not words.strip():
        hint = 'use `pqsec explain-error "Subject name is invalid"`, or `-` for stdin'
        raise UsageError("no message given", hint=hint)
    return words


def _standard_input() -> str:
    stream = getattr(sys.stdin, "buffer", None)
    try:
        data = stream.read(MAX_LOG + 1) if stream else b""  # None if it is closed
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FileError(f"standard input cannot be read: {reason}") from error
    if len(data) > MAX_LOG:
        hint = "pass a part of it, for example with `tail -n 1000`"
        raise FileError(f"standard input has more than {MAX_LOG >> 20} MiB", hint=hint)
    return str(data.decode(errors="replace"))


def _lines(
    found: tuple[Recognised, ...], near: tuple[Message, ...], *, in_log: bool
) -> Iterator[str]:
    alike = Counter[Message]()
    for number, each in enumerate(found):
        alike[each.message] += 1
        if alike[each.message] <= MOST_ALIKE:
            yield from [""] * (number > 0)
            yield from _explained(each, in_log=in_log)
    for row, times in alike.items():
        if times > MOST_ALIKE:
            yield ""
            yield f"{_source(row)}: {row.title}: {times - MOST_ALIKE} more (--json has them)"
    if not found:
        yield "The text does not contain a known message."
    if near:
        yield "Similar messages:"
        yield from (f"  {_source(row)}: {row.title}" for row in near)


def _explained(each: Recognised, *, in_log: bool) -> Iterator[str]:
    times = f", {each.times} times" if each.times > 1 else ""
    where = f" (line {each.line}{times})" if in_log else ""
    yield f"{_source(each.message)}: {each.said}{where}"
    yield from paragraph("  cause   ", each.cause)
    yield from paragraph("  remedy  ", each.remedy)


def _source(row: Message) -> str:
    who = " or ".join(stack.product for stack in row.stacks)
    return f"{who}, code {row.code}" if row.code else who


def _list(rows: tuple[Message, ...]) -> list[str]:
    heads = ("stack", "code", "message")
    texts = [(row, text) for row in rows for text in row.texts or (row.title,)]
    return _printing.table(
        heads, [(",".join(row.stacks), str(row.code or ""), text) for row, text in texts]
    )
