"""Findings as SARIF 2.1.0 (OASIS), the format of code scanning services and editors."""

from pathlib import Path
from typing import Any
from urllib.parse import quote

from pqsec_pki import __version__
from pqsec_pki.lint.rule import Finding, Rule, Severity, stacks_text
from pqsec_pki.lint.run import LintReport
from pqsec_pki.lint.table import RULES

SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "note"}


def to_sarif(report: LintReport) -> dict[str, Any]:
    """The log with one run, for json.dumps; it includes suppressed findings, marked as such."""
    places = {rule.id: place for place, rule in enumerate(RULES.values())}
    results = [_result(each, places) for each in report.findings]
    for finding, reason in report.ignored:
        suppression = {"kind": "external", "justification": reason}
        results.append(_result(finding, places) | {"suppressions": [suppression]})
    driver = {
        "name": "pqsec check",
        "version": __version__,
        "rules": [_descriptor(rule) for rule in RULES.values()],
    }
    run = {
        "tool": {"driver": driver},
        "invocations": [{"executionSuccessful": not report.unread}],
        "columnKind": "unicodeCodePoints",
        "results": results,
    }
    return {"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}


def _descriptor(rule: Rule) -> dict[str, Any]:
    return {
        "id": rule.id,
        "shortDescription": {"text": rule.title},
        "fullDescription": {"text": rule.why},
        "help": {"text": rule.fix},
        "defaultConfiguration": {"level": _LEVELS[rule.severity]},
        "properties": {"family": rule.family, "stacks": sorted(rule.stacks)},
    }


def _result(finding: Finding, places: dict[str, int]) -> dict[str, Any]:
    location: dict[str, Any] = {"artifactLocation": {"uri": _uri(finding.path)}}
    if finding.line:
        location["region"] = {"startLine": finding.line}
    more = {"code": finding.code.value} if finding.code else {}
    more |= {"stacks": stacks_text(finding.stacks)} if finding.stacks else {}
    return {
        "ruleId": finding.rule.id,
        "ruleIndex": places[finding.rule.id],
        "level": _LEVELS[finding.severity],
        "message": {"text": finding.message},
        "locations": [{"physicalLocation": location}],
        **({"properties": more} if more else {}),
    }


def _uri(path: Path) -> str:
    """The path as a URI; a relative path stays relative, so that services find it in a checkout."""
    octets = path.as_posix().encode(errors="surrogateescape")
    return ("file://" if path.is_absolute() else "") + quote(octets, safe="/")
