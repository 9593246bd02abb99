"""Finds what is wrong or risky in certificates, documents and keystores, before they are used.

For `pqsec check`, and for programs that need its findings as values. The rules are in families,
one module each (`rule` describes how); `check` runs them.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.lint.baseline import Baseline
    from pqsec_pki.lint.code_quality import to_code_quality
    from pqsec_pki.lint.collect import take_inventory
    from pqsec_pki.lint.document import GovernanceFile
    from pqsec_pki.lint.enclaves.size import largest_messages
    from pqsec_pki.lint.file import File
    from pqsec_pki.lint.rule import Finding, Rule, Severity, Violation, lint_rule, stacks_text
    from pqsec_pki.lint.run import LintReport, check
    from pqsec_pki.lint.sarif import to_sarif
    from pqsec_pki.lint.subjects import CertificateFile, Inventory
    from pqsec_pki.lint.suppress import Suppression, from_option
    from pqsec_pki.lint.table import RULES, rule_named
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "RULES",
    "Baseline",
    "CertificateFile",
    "File",
    "Finding",
    "GovernanceFile",
    "Inventory",
    "LintReport",
    "Rule",
    "Severity",
    "Suppression",
    "Violation",
    "check",
    "from_option",
    "largest_messages",
    "lint_rule",
    "rule_named",
    "stacks_text",
    "take_inventory",
    "to_code_quality",
    "to_sarif",
]
