"""Findings as a Code Quality report, which GitLab shows in merge requests.

A JSON list; each finding has a fingerprint, which stays the same while its line moves.
"""

import hashlib
from collections import Counter
from typing import Any

from pqsec_pki.lint.rule import Severity
from pqsec_pki.lint.run import LintReport

_SEVERITIES = {Severity.ERROR: "critical", Severity.WARNING: "minor", Severity.INFO: "info"}


def to_code_quality(report: LintReport) -> list[dict[str, Any]]:
    """The report, for json.dumps; without ignored findings, which the format does not know."""
    seen: Counter[tuple[str, ...]] = Counter()
    issues = []
    for each in report.findings:
        same = (each.rule.id, str(each.path), each.message)
        seen[same] += 1
        text = "\0".join((*same, str(seen[same])))
        issues.append(
            {
                "description": f"{each.message} ({each.rule.title}){each.stacks_in_brackets}",
                "check_name": each.rule.id,
                "fingerprint": hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest(),
                "severity": _SEVERITIES[each.severity],
                "location": {"path": str(each.path), "lines": {"begin": each.line or 1}},
            }
        )
    return issues
