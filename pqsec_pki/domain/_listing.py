"""Names of participants: in patterns such as /fleet/robot{001..100}, in CSV files, in lists."""

import csv
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.documents.parts_yaml import all_of, refused
from pqsec_pki.errors import InvalidDocumentError, UsageError, located, shown
from pqsec_pki.keystore import regular_name
from pqsec_pki.problems import Problem

MAX_PARTICIPANTS = 100_000
"""Of one domain; a slip in a pattern asks for more than that soon."""
MAX_PROBLEMS = 20
"""Shown of one list; the others are mostly alike."""
MAX_BRACES = 16
"""In one pattern: {,} sixteen times stands for 65,536 names."""
MAX_NAME = 64
"""Characters: the name is a certificate's CN (RFC 5280, ub-common-name)."""

_BRACES = re.compile(r"\{([^{}]*)\}")
_RANGE = re.compile(r"([0-9]{1,9})\.\.([0-9]{1,9})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Listed:
    """One name, where it stands, and what a CSV file says of it beside."""

    name: str
    line: int
    columns: Mapping[str, str] = field(default_factory=dict)


def names_of(pattern: str, line: int) -> list[Listed]:
    """All that a pattern stands for: {1..9} counts, {a,b} chooses; InvalidDocumentError."""
    braces = _BRACES.findall(pattern)
    if len(braces) > MAX_BRACES:
        raise refused(line, f"'{shown(pattern)}' has more than {MAX_BRACES} pairs of braces")
    choices = [_choices(each, pattern, line) for each in braces]
    count = math.prod(map(len, choices))
    if count > MAX_PARTICIPANTS:
        raise refused(line, f"'{shown(pattern)}' stands for {count} names")
    widths = list(map(_width, braces))
    between = _BRACES.split(pattern)[::2]
    return [
        Listed(_name("".join(_woven(between, chosen, widths)), line), line)
        for chosen in itertools.product(*choices)
    ]


def gathered(patterns: Iterable[tuple[str, int]]) -> list[Listed]:
    """All that these patterns, each with its line, stand for; InvalidDocumentError for too many."""
    found: list[Listed] = []
    problems: list[Problem] = []
    for pattern, line in patterns:
        try:
            found += names_of(pattern, line)
        except InvalidDocumentError as error:
            problems += error.problems
        if len(problems) >= MAX_PROBLEMS:
            break
        if len(found) > MAX_PARTICIPANTS:
            raise refused(line, f"more than {MAX_PARTICIPANTS} names")
    if problems:
        raise InvalidDocumentError(problems)
    return found


def names_in_list(path: Path) -> list[Listed]:
    """A list with a name, or pattern, on each line; what follows a # is for people.

    InvalidDocumentError with the lines at fault.
    """
    with located(path):
        lines = enumerate(map(_said, _text(path).splitlines()), start=1)
        return gathered((said, number) for number, said in lines if said)


def names_in_csv(path: Path) -> list[Listed]:
    """A table with a column `name`, and any others; its first line has their names.

    InvalidDocumentError with the lines at fault.
    """
    with located(path):
        rows = csv.reader(_text(path).splitlines(keepends=True), strict=True)
        try:
            numbered = [(rows.line_num, row) for row in rows if row]
        except csv.Error as error:
            raise refused(rows.line_num, f"not CSV: {error}") from None
        if not numbered or "name" not in (heads := [each.strip() for each in numbered[0][1]]):
            raise refused(1, "the first line names the columns, and one of them is `name`")
        twice = [each for each in dict.fromkeys(heads) if heads.count(each) > 1]
        if twice:
            raise refused(1, f"the column '{shown(twice[0])}' comes twice")
        return list(all_of(partial(_row, heads, line, row) for line, row in numbered[1:]))


def _row(heads: list[str], line: int, row: list[str]) -> Listed:
    if len(row) != len(heads):
        raise refused(line, f"{len(row)} values, and {len(heads)} columns")
    columns = dict(zip(heads, map(str.strip, row), strict=True))
    return Listed(_name(columns.pop("name"), line), line, columns)


def _text(path: Path) -> str:
    data = read(path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise refused(data[: error.start].count(b"\n") + 1, "not UTF-8 text") from None


def _said(line: str) -> str:
    return line.partition("#")[0].strip()


def _name(text: str, line: int) -> str:
    try:
        name = regular_name(text)
    except UsageError as error:
        raise refused(line, f"{error}; {error.hint}") from None
    if len(name) > MAX_NAME:
        raise refused(line, f"'{shown(name)}' has {len(name)} characters, and a name at most 64")
    return name


def _choices(inside: str, pattern: str, line: int) -> Sequence[int | str]:
    found = _RANGE.fullmatch(inside)
    if not found:
        if "," in inside:
            return inside.split(",")
        raise refused(line, f"'{shown(pattern)}': in braces stands {{001..100}} or {{a,b,c}}")
    first, last = map(int, found.groups())
    if first > last:
        raise refused(line, f"'{shown(pattern)}': {{{inside}}} counts to less than it begins with")
    return range(first, last + 1)


def _width(inside: str) -> int:
    """How many digits a number has at least: as many as the first, if that begins with 0."""
    return len(inside.partition("..")[0]) if inside.startswith("0") else 1


def _woven(between: list[str], chosen: tuple[int | str, ...], widths: list[int]) -> Iterator[str]:
    yield between[0]
    for choice, width, rest in zip(chosen, widths, between[1:], strict=True):
        yield f"{choice:0{width}}" if isinstance(choice, int) else choice
        yield rest
