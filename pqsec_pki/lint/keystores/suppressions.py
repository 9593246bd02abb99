"""Rules about suppressions: without a reason, expired, unused, or invalid."""

from collections.abc import Iterator

from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.suppress import SuppressionFile


@lint_rule(
    "PQS002", Severity.ERROR, "a suppression gives no reason",
    why="Without a reason, a later reader cannot tell whether the finding is still accepted. The"
    " suppression is not applied.",
    fix="Add `reason:` to the entry: who decided, and why it is safe.",
    bad="""
        ignore:
          - rule: PQS707
    """,
    good="""
        ignore:
          - rule: PQS707
            reason: a test keystore on an encrypted disk
    """,
)  # fmt: skip
def without_reason(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries:
        if not entry.reason:
            yield Violation(f"the suppression of {entry.rule} gives no reason", entry.line)


@lint_rule(
    "PQS003", Severity.WARNING, "a suppression has expired",
    why="The date in `until:` has passed. The suppression is no longer applied.",
    fix="Fix the finding that it suppressed, or decide again and set a later date.",
    bad="""
        ignore:
          - rule: PQS707
            reason: a test keystore on an encrypted disk
            until: 2026-01-31
    """,
    good="""
        ignore:
          - rule: PQS707
            reason: a test keystore on an encrypted disk
            until: 2099-12-31
    """,
)  # fmt: skip
def expired(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries:
        if entry.has_expired(file.today):
            yield Violation(f"the suppression of {entry.rule} expired on {entry.until}", entry.line)


@lint_rule(
    "PQS004", Severity.WARNING, "a suppression is unused",
    why="No finding matches it. It would hide the problem if it came back.",
    fix="Remove the entry.",
    bad="""
        ignore:
          - rule: PQS224
            reason: domain 3 is a test bench
    """,
    good="ignore: []",
)  # fmt: skip
def unused(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries if file.is_complete else ():
        holds = entry.reason and not entry.has_expired(file.today) and entry.rule in file.asked
        if holds and not entry.used:
            yield Violation(f"the suppression of {entry.rule} matches no finding", entry.line)


@lint_rule(
    "PQS005", Severity.ERROR, "a suppression is invalid",
    why="The entry does not suppress what it was meant to suppress, or it suppresses another rule.",
    fix="Write entries with rule and reason, and optionally path and until.",
    bad="""
        ignore:
          - rule: PQS9999
            reason: a test keystore on an encrypted disk
    """,
    good="""
        ignore:
          - rule: PQS707
            reason: a test keystore on an encrypted disk
    """,
)  # fmt: skip
def invalid_entry(file: SuppressionFile) -> Iterator[Violation]:
    yield from file.broken
    for entry in file.entries:
        if entry.rule not in file.known:
            yield Violation(f"there is no rule {entry.rule}", entry.line)
