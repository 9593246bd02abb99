"""Suppressions: findings that somebody accepted, with the reason.

In `.pqsec-check.yaml`, in the folder that is checked:

    ignore:
      - rule: PQS224
        path: enclaves/legacy/*      # optional: only there
        reason: the old scanner needs domain 3 in the clear until it is replaced
        until: 2027-06-30            # optional: the last day it holds
"""

import re
from contextlib import suppress
from dataclasses import field
from datetime import date
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents.parts_yaml import Item, Text, each, fields, read, refused
from pqsec_pki.errors import InvalidDocumentError, PqsecError, UsageError, shown
from pqsec_pki.lint.rule import Finding, Violation

FILE_NAME = ".pqsec-check.yaml"
MAX_FILE = 256 << 10
"""Bytes. A thousand suppressions are 100 kB."""
_NOTHING = {"null", "~"}
_DAY = re.compile("[0-9]{4}-[0-9]{2}-[0-9]{2}")
_REMARKS = re.compile(rb"(?m)^[ \t]*#.*$")


@dataclass(slots=True, kw_only=True)
class Suppression:
    """One entry; `used` counts the findings that it suppressed."""

    rule: str
    reason: str
    path: str = "*"
    """A pattern for paths below the folder of the suppression file."""
    until: date | None = None
    line: int | None = None
    used: int = 0

    def covers(self, finding: Finding, folder: Path | None, today: date) -> bool:
        """Whether it matches the finding, has a reason and has not expired."""
        if self.rule != finding.rule.id or not self.reason or self.has_expired(today):
            return False
        if folder is None:
            return True
        below = _below(finding.path, folder)
        return below is not None and fnmatchcase(below, self.path)

    def has_expired(self, today: date) -> bool:
        """Whether its last day has passed."""
        return self.until is not None and self.until < today


@dataclass(frozen=True, slots=True)
class SuppressionFile:
    """The entries of one suppression file, and its problems: a subject of rules."""

    path: Path
    folder: Path | None
    """The base of the patterns; None for the command line, whose entries match everywhere."""
    entries: tuple[Suppression, ...]
    broken: tuple[Violation, ...] = ()
    today: date = field(default=date.min)
    is_complete: bool = True
    """Whether the whole folder was checked, so that an unused entry can be reported."""
    known: frozenset[str] = frozenset()
    """The ids of all rules."""
    asked: frozenset[str] = frozenset()
    """The ids of the rules that ran."""

    def take(self, finding: Finding) -> Suppression | None:
        """The entry that matches `finding`, counted as used; None if there is none."""
        for entry in self.entries:
            if entry.covers(finding, self.folder, self.today):
                entry.used += 1
                return entry
        return None


def from_option(text: str) -> Suppression:
    """The suppression of --ignore ID=reason; UsageError without a reason."""
    rule, _, reason = text.partition("=")
    if not rule.strip() or not reason.strip():
        raise UsageError(
            f"--ignore {text}: no reason given",
            hint='as in --ignore PQS224="domain 3 is a test bench"',
        )
    return Suppression(rule=rule.strip(), reason=reason.strip())


def read_suppressions(path: Path) -> tuple[tuple[Suppression, ...], tuple[Violation, ...]]:
    """(entries, problems) of the file; problems are returned, not raised."""
    entries: list[Suppression] = []
    broken: list[Violation] = []
    try:
        data = _files.read(path, limit=MAX_FILE)
        if _REMARKS.sub(b"", data).strip():
            read(data, lambda item: fields(item, {"ignore": partial(_read_all, into=entries)}))
    except InvalidDocumentError as error:
        broken = [Violation(each.message, each.line) for each in error.problems]
    except PqsecError as error:
        broken = [Violation(f"cannot be read: {error.words_at(path)}")]
    return tuple(entries), tuple(broken)


def _read_all(item: Item, *, into: list[Suppression]) -> None:
    """Read the entries; valid ones count even if others are invalid."""
    each(item, lambda one: into.append(_entry(one)))


def _entry(item: Item) -> Suppression:
    """One entry. PQS002 reports a missing reason."""
    readers = {"rule": _words, "path": _words, "reason": _words, "until": _day}
    values = fields(item, readers, required=("rule",))
    return Suppression(
        rule=values["rule"].strip(),
        reason=values.get("reason", "").strip(),
        path=values.get("path", "*"),
        until=values.get("until"),
        line=item.line,
    )


def _words(item: Item) -> str:
    """The text as it is written: a date or a number needs no quotes."""
    if not isinstance(item, Text) or (item.plain and item.text in _NOTHING):
        raise refused(item, "must be plain text")
    return item.text


def _day(item: Item) -> date:
    words = _words(item)
    with suppress(ValueError):
        if _DAY.fullmatch(words):
            return date.fromisoformat(words)
    raise refused(item, f"{shown(words)!r} is not a date such as 2027-06-30")


def _below(path: Path, folder: Path) -> str | None:
    """The path relative to the folder, before or after resolving links; None if outside."""
    with suppress(OSError):
        for found, root in ((path, folder), (_files.resolved(path), _files.resolved(folder))):
            if found.is_relative_to(root) and ".." not in found.relative_to(root).parts:
                return found.relative_to(root).as_posix()
    return None
