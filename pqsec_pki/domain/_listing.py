"""Reads names of participants from patterns such as /fleet/robot{001..100}, CSV files and lists."""

import csv
import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from functools import partial
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.certificates import MAX_COMMON_NAME
from pqsec_pki.documents.parts_yaml import all_of, refuse_unseen_ends, refused
from pqsec_pki.errors import InvalidDocumentError, UsageError, located, shown
from pqsec_pki.keystore import regular_name
from pqsec_pki.problems import Problem

MAX_PARTICIPANTS = 100_000
"""Participants of one domain; a mistake in a pattern soon exceeds it."""
MAX_PROBLEMS = 20
"""Shown of one list; the others are mostly similar."""
MAX_BRACES = 16
"""In one pattern: {,} sixteen times gives 65,536 names."""

_BRACES = re.compile(r"\{([^{}]*)\}")
_RANGE = re.compile(r"([0-9]{1,9})\.\.([0-9]{1,9})", re.ASCII)


@dataclass(frozen=True, slots=True)
class ListedName:
    """One name, its line, and the other columns of its CSV row."""

    name: str
    line: int
    columns: Mapping[str, str] = field(default_factory=dict)


def names_of(pattern: str, line: int) -> list[ListedName]:
    """The names that a pattern gives: {1..9} counts, {a,b} lists; InvalidDocumentError."""
    return [ListedName(regular(each, line), line) for each in without_braces(pattern, line)]


def without_braces(pattern: str, line: int) -> list[str]:
    """The texts that a pattern gives, which may be no names; InvalidDocumentError."""
    braces = _BRACES.findall(pattern)
    if len(braces) > MAX_BRACES:
        raise refused(line, f"'{shown(pattern)}' has more than {MAX_BRACES} pairs of braces")
    choices = [_choices(each, pattern, line) for each in braces]
    count = math.prod(map(len, choices))
    if count > MAX_PARTICIPANTS:
        raise refused(line, f"'{shown(pattern)}' gives {count} names")
    widths = list(map(_width, braces))
    between = _BRACES.split(pattern)[::2]
    return [
        "".join(_interleaved(between, chosen, widths)) for chosen in itertools.product(*choices)
    ]


def expanded(patterns: Iterable[tuple[str, int]]) -> list[ListedName]:
    """The names of all patterns, each given with its line; InvalidDocumentError for too many."""
    found: list[ListedName] = []
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


def names_in_list(path: Path) -> list[ListedName]:
    """Read a list with a name or pattern on each line; a # begins a comment.

    InvalidDocumentError with the lines at fault.
    """
    with located(path):
        lines = enumerate(map(_without_comment, _text(path).split("\n")), start=1)
        return expanded((pattern, number) for number, pattern in lines if pattern)


def names_in_csv(path: Path) -> list[ListedName]:
    """Read a table with a column `name` and any others; its first line has the column names.

    InvalidDocumentError with the lines at fault.
    """
    with located(path):
        rows = csv.reader(io.StringIO(_text(path), newline=""), strict=True)
        try:
            numbered = [(rows.line_num, row) for row in rows if row]
        except csv.Error as error:
            raise refused(rows.line_num, f"not CSV: {error}") from None
        if not numbered or "name" not in (header := [each.strip() for each in numbered[0][1]]):
            raise refused(1, "the first line must have the column names, one of them `name`")
        twice = [each for each, count in Counter(header).items() if count > 1]
        if twice:
            raise refused(1, f"the column '{shown(twice[0])}' appears twice")
        return list(all_of(partial(_row, header, line, row) for line, row in numbered[1:]))


def _row(header: list[str], line: int, row: list[str]) -> ListedName:
    if len(row) != len(header):
        raise refused(line, f"{len(row)} values for {len(header)} columns")
    columns = dict(zip(header, map(str.strip, row), strict=True))
    return ListedName(regular(columns.pop("name"), line), line, columns)


def _text(path: Path) -> str:
    data = read(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise refused(data[: error.start].count(b"\n") + 1, "not UTF-8 text") from None
    refuse_unseen_ends(text)
    return text


def _without_comment(line: str) -> str:
    return line.partition("#")[0].strip()


def regular(text: str, line: int) -> str:
    """The text as a participant's name; InvalidDocumentError if it cannot be one."""
    try:
        name = regular_name(text)
    except UsageError as error:
        raise refused(line, f"{error}; {error.hint}") from None
    if len(name) > MAX_COMMON_NAME:  # it is a certificate's CN
        raise refused(
            line,
            f"'{shown(name)}' has {len(name)} characters: at most {MAX_COMMON_NAME} are allowed",
        )
    return name


def _choices(inside: str, pattern: str, line: int) -> Sequence[int | str]:
    found = _RANGE.fullmatch(inside)
    if not found:
        if "," in inside:
            return inside.split(",")
        raise refused(line, f"'{shown(pattern)}': write {{001..100}} or {{a,b,c}} in braces")
    first, last = map(int, found.groups())
    if first > last:
        raise refused(line, f"'{shown(pattern)}': {{{inside}}} ends below its first number")
    return range(first, last + 1)


def _width(inside: str) -> int:
    """The minimum number of digits: that of the first number if it begins with 0, else 1."""
    return len(inside.partition("..")[0]) if inside.startswith("0") else 1


def _interleaved(
    between: list[str], chosen: tuple[int | str, ...], widths: list[int]
) -> Iterator[str]:
    yield between[0]
    for choice, width, rest in zip(chosen, widths, between[1:], strict=True):
        yield f"{choice:0{width}}" if isinstance(choice, int) else choice
        yield rest
