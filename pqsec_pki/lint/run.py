"""Runs every rule on every subject, and sets suppressed findings aside."""

import os
from collections.abc import Container, Iterable, Iterator
from dataclasses import field
from datetime import date, datetime
from functools import partial
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._progress import counted
from pqsec_pki.credentials import ENCLAVES, TrustAnchors
from pqsec_pki.lint._plain import NEVER_IN_PLAIN
from pqsec_pki.lint.collect import take_inventory
from pqsec_pki.lint.document import PlainPermissions
from pqsec_pki.lint.enclaves.trust import without_repetitions
from pqsec_pki.lint.keystores.files import PRIVATE
from pqsec_pki.lint.keystores.incomplete import UNREAD
from pqsec_pki.lint.rule import Finding, Rule, Severity, is_about
from pqsec_pki.lint.subjects import Compare, Inventory
from pqsec_pki.lint.suppress import FILE_NAME, Suppression, SuppressionFile, read_suppressions
from pqsec_pki.lint.table import RULES

COMMAND_LINE = Path("--ignore")
_RANK = {severity: rank for rank, severity in enumerate(Severity)}


@dataclass(frozen=True, slots=True, kw_only=True)
class LintReport:
    """The findings of one run."""

    findings: tuple[Finding, ...]
    """Sorted by path and line; within a line, the most severe first."""
    ignored: tuple[tuple[Finding, str], ...]
    """(suppressed finding, reason)."""
    inventory: Inventory = field(repr=False)

    def count(self, severity: Severity) -> int:
        """How many findings are of that severity."""
        return sum(finding.severity is severity for finding in self.findings)

    def is_clean(self, *, strict: bool = False) -> bool:
        """Whether there is no error and, with `strict`, no warning."""
        warnings = self.count(Severity.WARNING) if strict else 0
        return not self.count(Severity.ERROR) and not warnings

    @property
    def unread(self) -> tuple[Finding, ...]:
        """Findings about unreadable files: if there are any, the check is incomplete.

        A keystore's folder of CA keys does not count, because others must not read it.
        """
        found = [each for each in self.findings if each.rule.id == UNREAD]
        known = {*self.inventory.folders, *(file.path for file in self.inventory.files)}
        return tuple(each for each in found if not _is_of_ca_keys(each.path, known))

    @property
    def files_read(self) -> int:
        """How many files were checked."""
        return sum(not file.unreadable for file in self.inventory.files)

    def to_json(self, *, strict: bool = False) -> dict[str, object]:
        """The report for --json; `strict` as in `is_clean`."""
        incomplete = bool(self.unread or self.inventory.interrupted_change)
        return {
            "ok": self.is_clean(strict=strict) and not incomplete,
            "incomplete": incomplete,
            "files": self.files_read,
            "counts": {severity.value: self.count(severity) for severity in Severity},
            "findings": self.findings,
            "ignored": [each.to_json() | {"reason": reason} for each, reason in self.ignored],
        }


def check(  # noqa: PLR0913 -- one for each option
    paths: Iterable[Path],
    *,
    now: datetime,
    targets: Iterable[str] = (),
    ignore: Iterable[Suppression] = (),
    anchors: TrustAnchors | None = None,
    proofs: bool = False,
    compare: Compare | None = None,
) -> LintReport:
    """Find everything that is wrong or risky in these files, folders and keystores.

    No `targets` means all stacks. FileError if a path itself cannot be read; problems and
    unreadable files inside are findings. Documents that `anchors` verified before are not verified
    again. With `proofs`, each enclave must have one that the ledger has its documents;
    `compare` compares enclaves with what was seen there before.
    """
    named = list(paths)
    inventory = take_inventory(named, now=now, anchors=anchors, proofs=proofs, compare=compare)
    meant = frozenset(targets)
    asked = [rule for rule in RULES.values() if rule.matters_to(meant)]
    files = list(_suppression_files(named, tuple(ignore), asked, now.date()))
    kept: list[Finding] = []
    ignored: list[tuple[Finding, str]] = []
    running = [rule for rule in RULES.values() if rule.runs_for(meant)]
    for finding in _findings(running, inventory, meant):
        taken = next((entry for file in files if (entry := file.take(finding))), None)
        if taken:
            ignored.append((finding, taken.reason))
        else:
            kept.append(finding)
    kept += _answers(asked, files)
    return LintReport(
        findings=tuple(sorted(kept, key=_order)), ignored=tuple(ignored), inventory=inventory
    )


def _is_of_ca_keys(path: Path, known: Container[Path]) -> bool:
    """Whether it is a keystore's folder private/ (next to enclaves/), or inside it."""
    folders = (each for each in (path, *path.parents) if each.name == PRIVATE)
    return any(each.parent / ENCLAVES in known for each in folders)


def _order(finding: Finding) -> tuple[Path, int, int, str, str]:
    rule = finding.rule
    return (finding.path, finding.line or 0, _RANK[finding.severity], rule.id, finding.message)


def _findings(
    running: Iterable[Rule], inventory: Inventory, targets: frozenset[str]
) -> Iterator[Finding]:
    subjects = (
        *inventory.files,
        *inventory.documents,
        *inventory.profiles,
        *inventory.certificates,
        inventory,  # before the enclaves: it verifies documents that were parsed here
        *inventory.enclaves,
    )
    checked = counted(subjects, len(subjects), "subjects")
    found = (
        each
        for each in _answers(running, checked)
        if is_about(each.stacks, targets)
        and not (each.stacks and inventory.is_of_further_set(each.path))
    )
    return without_repetitions(found, inventory)


def _answers(running: Iterable[Rule], subjects: Iterable[object]) -> Iterator[Finding]:
    rules = list(running)
    of_class: dict[type, list[Rule]] = {}
    for subject in subjects:
        kind = type(subject)
        if kind not in of_class:
            of_class[kind] = [rule for rule in rules if _concerns(rule, kind)]
        for rule in of_class[kind]:
            for found in rule.check(subject):
                yield Finding.of(rule, found, subject.path)  # type: ignore[attr-defined] # all have one


def _concerns(rule: Rule, kind: type) -> bool:
    """Whether the rule can find anything in a subject of that class."""
    if issubclass(kind, PlainPermissions) and rule.id in NEVER_IN_PLAIN:
        return False
    return issubclass(kind, rule.scope)


def _suppression_files(
    named: list[Path], options: tuple[Suppression, ...], asked: list[Rule], today: date
) -> Iterator[SuppressionFile]:
    ids = frozenset(rule.id for rule in asked)
    made = partial(SuppressionFile, today=today, known=frozenset(RULES), asked=ids)
    yield made(COMMAND_LINE, None, options)
    for folder in dict.fromkeys(path if path.is_dir() else path.parent for path in named):
        path = folder / FILE_NAME
        if os.path.isfile(path):  # noqa: PTH113 -- Path.is_file raises where the folder is closed
            entries, broken = read_suppressions(path)
            yield made(path, folder, entries, broken, is_complete=folder in named)
