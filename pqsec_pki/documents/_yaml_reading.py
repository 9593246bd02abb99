"""Reads the values of a policy in YAML.

A reader returns the value of an item, or raises InvalidDocumentError with all its problems,
each with its line and innermost key.
"""

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from difflib import get_close_matches
from enum import StrEnum
from functools import partial
from typing import Any, TypeVar

from pqsec_pki.documents._xml import MAX_PROBLEMS
from pqsec_pki.documents._yaml import Item, Items, Text, YamlMapping, parse, refused
from pqsec_pki.documents._yaml_guesses import guess
from pqsec_pki.errors import InvalidDocumentError, UsageError, shown
from pqsec_pki.problems import Problem

Value = TypeVar("Value")
Chosen = TypeVar("Chosen", bound=StrEnum)


def read(data: bytes, reader: Callable[[Item], Value]) -> Value:
    """The value that `reader` returns for the document.

    InvalidDocumentError lists the problems, each with its line, and its key if there is one.
    """
    return readable_problems(lambda: reader(parse(data)))


def readable_problems(reading: Callable[[], Value]) -> Value:
    """The result; problems of InvalidDocumentError are limited in number and made readable."""
    try:
        return reading()
    except InvalidDocumentError as error:
        problems = [_worded(problem) for problem in error.problems]
    if (rest := len(problems) - MAX_PROBLEMS) > 0:
        problems[MAX_PROBLEMS:] = [Problem(f"and {rest} more")]
    raise InvalidDocumentError(problems)


def _worded(problem: Problem) -> Problem:
    key = f"{problem.element}: " if problem.element else ""
    return Problem(f"{key}{problem.message}", line=problem.line)


def all_of(readings: Iterable[Callable[[], Value]]) -> tuple[Value, ...]:
    """The results; InvalidDocumentError with the problems of all of them."""
    results: list[Value] = []
    problems: list[Problem] = []
    for reading in readings:
        try:
            results.append(reading())
        except InvalidDocumentError as error:
            problems += error.problems
    if problems:
        raise InvalidDocumentError(problems)
    return tuple(results)


def each(item: Item, reader: Callable[[Item], Value]) -> tuple[Value, ...]:
    """The values that `reader` returns for the items of a list."""
    if not isinstance(item, Items):
        raise refused(item, f"expected a list here, found {_described(item)}")
    return all_of(partial(reader, each) for each in item.items)


def one_or_more(item: Item, reader: Callable[[Item], Value]) -> tuple[Value, ...]:
    """Like `each`, but a single item needs no list."""
    return each(item, reader) if isinstance(item, Items) else (reader(item),)


def table(item: Item) -> YamlMapping:
    """The item, which must be a mapping."""
    if not isinstance(item, YamlMapping):
        # The text is not quoted: in another file it may be a key or a passphrase.
        what = "a text" if isinstance(item, Text) and item.text else _described(item)
        raise refused(item, f"expected `key: value` here, found {what}")
    return item


def fields(
    item: Item, readers: Mapping[str, Callable[[Item], Any]], *, required: Collection[str] = ()
) -> dict[str, Any]:
    """The values of the keys that the mapping has, read by their readers.

    Other keys are refused, with the nearest correct key; so are missing required keys.
    """
    found = table(item)
    missing = [key for key in required if key not in found.entries]
    return dict(
        all_of(
            [partial(_missing, found, key) for key in missing]
            + [partial(_field, *entry, readers) for entry in found.entries.values()]
        )
    )


def peeked(item: Item, key: str, reader: Callable[[Item], Value], default: Value) -> Value:
    """The value of a key that other readers need first; the default if it cannot be read.

    `fields` then reports what is wrong with it.
    """
    try:
        return reader(table(item).entries[key][1])
    except (InvalidDocumentError, KeyError):
        return default


def _missing(item: YamlMapping, key: str) -> tuple[str, Any]:
    raise refused(item, f"the key '{key}' is missing")


def _field(key: Text, value: Item, readers: Mapping[str, Callable[[Item], Any]]) -> tuple[str, Any]:
    if key.text not in readers:
        unknown = f"no such key here{_meant(key.text, readers)}"
        raise InvalidDocumentError([Problem(unknown, line=key.line, element=shown(key.text))])
    try:
        return key.text, readers[key.text](value)
    except InvalidDocumentError as error:
        problems = [p if p.element else replace(p, element=key.text) for p in error.problems]
        raise InvalidDocumentError(problems) from None


def build(item: Item, make: Callable[..., Value], **values: object) -> Value:
    """make(**values); a UsageError becomes an error at the item's line."""
    try:
        return make(**values)
    except UsageError as error:
        hint = f"; {error.hint}" if error.hint else ""
        raise refused(item, f"{error}{hint}") from None


def text(item: Item) -> str:
    """A text; it must be in quotes if YAML would read it as another type."""
    if not isinstance(item, Text):
        raise refused(item, f"expected a text here, found {_described(item)}")
    if item.plain and not item.text:
        raise refused(item, "no value; for an empty text write ''")
    if item.plain and (meant := guess(item.text)):
        raise refused(item, f"YAML reads {shown(item.text)} as {meant}; put it in quotes")
    return item.text


def boolean(item: Item) -> bool:
    """true or false."""
    if isinstance(item, Text) and item.plain and item.text in {"true", "false"}:
        return item.text == "true"
    raise refused(item, f"{_quoted(item)} is not true or false")


def chosen(item: Item, names: Collection[str]) -> str:
    """One of the names."""
    if isinstance(item, Text) and item.text in names:
        return item.text
    wrong = item.text if isinstance(item, Text) else ""
    raise refused(item, f"{_quoted(item)} is not allowed{_meant(wrong, names)}")


def one_of(kind: type[Chosen], item: Item) -> Chosen:
    """One of the words of `kind`."""
    return kind(chosen(item, list(kind)))


def number(item: Item) -> int:
    """A whole number, 0 or more."""
    if isinstance(item, Text) and item.plain and re.fullmatch(r"0|[1-9][0-9]{0,9}", item.text):
        return int(item.text)
    zeros = " (YAML reads a number that begins with 0 as octal)"
    octal = zeros if isinstance(item, Text) and re.fullmatch("0[0-9]+", item.text) else ""
    raise refused(item, f"{_quoted(item)} is not a number from 0 on{octal}")


_TIME = re.compile(r"\d{4}-\d\d-\d\dT(?!24)\d\d:\d\d:\d\d(Z|[+-]\d\d:\d\d)", re.ASCII)


def time(item: Item) -> datetime:
    """A time with its zone, in UTC."""
    written = item.text if isinstance(item, Text) else ""
    try:
        if _TIME.fullmatch(written):
            return datetime.fromisoformat(written).astimezone(UTC)
    except (ValueError, OverflowError):
        pass
    raise refused(item, f"{_quoted(item)} is not a time with a zone, such as 2030-01-31T00:00:00Z")


def _quoted(item: Item) -> str:
    return f"'{shown(item.text)}'" if isinstance(item, Text) else _described(item)


def _described(item: Item) -> str:
    if isinstance(item, Text):
        return f"the text '{shown(item.text, 40)}'" if item.text else "nothing"
    return "a list" if isinstance(item, Items) else "a mapping of keys to values"


def _meant(wrong: str, names: Collection[str]) -> str:
    upper = {name.upper(): name for name in names}
    near = get_close_matches(wrong.upper(), upper, n=1)
    meant = f"; did you mean {upper[near[0]]}?" if near else ";"
    return f"{meant} allowed: {', '.join(names)}"
