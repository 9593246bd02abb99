"""Suppressions: findings that somebody has looked at, and says why they may stay.

In `.pqsec-check.yaml`, in the folder that is checked:

    ignore:
      - rule: PQS224
        path: enclaves/legacy/*      # optional: only there
        reason: the old scanner needs domain 3 in the clear until it is replaced
        until: 2027-06-30            # optional: the last day it holds
"""

from contextlib import suppress
from dataclasses import dataclass, field
from datetime import date
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._files import read
from pqsec_pki.errors import PqsecError, UsageError
from pqsec_pki.lint.rule import Finding, Found

if TYPE_CHECKING:
    from yaml.nodes import MappingNode, Node

FILE_NAME = ".pqsec-check.yaml"
MAX_FILE = 256 << 10
"""Bytes. A thousand suppressions are 100 kB."""
_KEYS = {"rule", "path", "reason", "until"}


@dataclass(slots=True, kw_only=True)
class Suppression:
    """One entry; `used` counts the findings it took."""

    rule: str
    reason: str
    path: str = "*"
    """A pattern for the path below the folder of the file it stands in."""
    until: date | None = None
    line: int | None = None
    used: int = 0

    def covers(self, finding: Finding, folder: Path | None, today: date) -> bool:
        """Whether it speaks of this finding, has a reason and has not run out."""
        if self.rule != finding.rule.id or not self.reason or self.is_over(today):
            return False
        if folder is None:
            return True
        below = _below(finding.path, folder)
        return below is not None and fnmatchcase(below, self.path)

    def is_over(self, today: date) -> bool:
        """Whether its last day has passed."""
        return self.until is not None and self.until < today


@dataclass(frozen=True, slots=True)
class SuppressionFile:
    """The entries of one file, and what is wrong with it. Rules of the frame look at it."""

    path: Path
    folder: Path | None
    """What patterns are relative to; None for the command line, whose entries hold for all."""
    entries: tuple[Suppression, ...]
    broken: tuple[Found, ...] = ()
    today: date = field(default=date.min)
    is_complete: bool = True
    """Whether all it could speak of was checked, so that what is unused is superfluous."""
    known: frozenset[str] = frozenset()
    """The ids of all rules."""
    asked: frozenset[str] = frozenset()
    """The ids of the rules that were asked in this run."""

    def take(self, finding: Finding) -> Suppression | None:
        """The entry that covers `finding`, counted as used."""
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
            f"--ignore {text}: say why", hint='as in --ignore PQS224="domain 3 is a test bench"'
        )
    return Suppression(rule=rule.strip(), reason=reason.strip())


def read_suppressions(path: Path) -> tuple[tuple[Suppression, ...], tuple[Found, ...]]:
    """The entries of the file, and what is wrong with it; nothing in it raises."""
    import yaml  # noqa: PLC0415 -- few runs have such a file

    try:
        root = yaml.compose(read(path, limit=MAX_FILE), yaml.SafeLoader)
        lists = _members(root)
    except (PqsecError, yaml.YAMLError, RecursionError, ValueError) as error:
        reason = str(error).removeprefix(f"{path}: ").splitlines()[0]
        return (), (Found(f"cannot be read: {reason}"),)
    broken = [Found(f"knows no {name!r}, only ignore", line) for name, line in lists.unknown]
    entries: list[Suppression] = []
    for item in lists.items:
        try:
            entries.append(_entry(item))
        except ValueError as error:
            broken.append(Found(str(error), item.start_mark.line + 1))
    return tuple(entries), tuple(broken)


@dataclass(frozen=True, slots=True)
class _Members:
    items: "tuple[MappingNode, ...]"
    unknown: tuple[tuple[str, int], ...]


def _members(root: "Node | None") -> _Members:
    """The entries under `ignore`; ValueError if the file is of another shape."""
    from yaml.nodes import MappingNode, SequenceNode  # noqa: PLC0415

    if root is None:
        return _Members((), ())
    if not isinstance(root, MappingNode):
        raise ValueError("not a mapping with `ignore:` and a list under it")  # noqa: TRY004
    items: list[MappingNode] = []
    unknown: list[tuple[str, int]] = []
    for key, value in root.value:
        if key.value != "ignore":
            unknown.append((_text(key), key.start_mark.line + 1))
        elif not isinstance(value, SequenceNode):
            raise ValueError("`ignore:` wants a list under it")
        elif items:  # with aliases, a small file could so say millions
            raise ValueError("`ignore:` comes twice")
        else:
            items += value.value
    if not all(isinstance(item, MappingNode) for item in items):
        raise ValueError("each entry of `ignore:` says rule and reason")
    return _Members(tuple(items), tuple(unknown))


def _entry(item: "MappingNode") -> Suppression:
    """One entry; ValueError says what it lacks. A missing reason is a rule's business."""
    words = {_text(key): _text(value) for key, value in item.value}
    if len(words) < len(item.value):
        raise ValueError("an entry says something twice")
    if unknown := sorted(words.keys() - _KEYS):
        raise ValueError(f"knows no {unknown[0]!r}, only {', '.join(sorted(_KEYS))}")
    if not words.get("rule"):
        raise ValueError("an entry says no rule")
    return Suppression(
        rule=words["rule"].strip(),
        reason=words.get("reason", "").strip(),
        path=words.get("path", "*"),
        until=_day(words["until"]) if "until" in words else None,
        line=item.start_mark.line + 1,
    )


def _text(node: "Node") -> str:
    from yaml.nodes import ScalarNode  # noqa: PLC0415

    if not isinstance(node, ScalarNode):
        raise ValueError("the words of an entry, and what they say, are plain text")  # noqa: TRY004
    return str(node.value)


def _day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise ValueError(f"until: {text!r} is no day such as 2027-06-30") from None


def _below(path: Path, folder: Path) -> str | None:
    """The path from the folder on, as it is named or else where links lead; None outside."""
    with suppress(OSError):
        for found, root in ((path, folder), (path.resolve(), folder.resolve())):
            if found.is_relative_to(root) and ".." not in found.relative_to(root).parts:
                return found.relative_to(root).as_posix()
    return None
