"""Findings that were there before: what `pqsec check --json` printed, set aside in a later check.

A finding is the same if its rule, file and words are; its line may differ, since lines move. Each
entry is for one finding, so a second equal one is new. What cannot be read is never old.
"""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, TypeAlias

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError, MissingError, located
from pqsec_pki.lint.rule import Finding
from pqsec_pki.lint.run import LintReport

MAX_BASELINE = 64 << 20
"""Bytes. A finding has about 600."""
REASON = "in the baseline"
_TO_WRITE = "write one: `pqsec check --json > FILE`, with the same paths"
_Key: TypeAlias = tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Baseline:
    """How many findings there were of each rule, file and message."""

    known: Mapping[_Key, int]

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the file; FileError, or MalformedError if it is not what check prints as JSON."""
        try:
            data = _files.read(path, limit=MAX_BASELINE)
        except MissingError as error:
            error.hint = _TO_WRITE
            raise
        with located(path):
            try:
                found = json.loads(data)["findings"]
                return cls(Counter(map(_entry, found)))
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                raise MalformedError(
                    "not a baseline: it has no findings as `pqsec check --json` prints them",
                    hint=_TO_WRITE,
                ) from error

    def apart(self, report: LintReport) -> tuple[LintReport, int]:
        """The report with old findings among the ignored ones, and how many are gone by now."""
        left = Counter(self.known)
        unread = set(map(id, report.unread))
        kept, old = list[Finding](), list[tuple[Finding, str]]()
        for each in report.findings:
            if id(each) not in unread and left[_key(each)]:
                left[_key(each)] -= 1
                old.append((each, REASON))
            else:
                kept.append(each)
        split = replace(report, findings=tuple(kept), ignored=(*report.ignored, *old))
        return split, left.total()


def _key(finding: Finding) -> _Key:
    return finding.rule.id, str(finding.path), finding.message


def _entry(value: Any) -> _Key:
    found = value["rule"], value["path"], value["message"]
    if not all(isinstance(each, str) for each in found):
        raise TypeError("no text")
    return found
