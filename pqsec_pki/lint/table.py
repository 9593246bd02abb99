"""The table of all rules. A new family is one more line here."""

from pqsec_pki.errors import UsageError
from pqsec_pki.lint import (
    _frame,
    cross,
    enclaves,
    expressions,
    extensions,
    files,
    governance,
    naming,
    permissions,
    post_quantum,
    revocation,
    ros_nodes,
    signing,
    size,
    stack_differences,
    subject_encoding,
    subject_names,
    times,
    trust,
    validity,
    x509,
    xml_form,
    xml_values,
)
from pqsec_pki.lint.rule import Rule

FAMILIES = (
    _frame.FAMILY,
    x509.FAMILY,
    extensions.FAMILY,
    revocation.FAMILY,
    xml_form.FAMILY,
    xml_values.FAMILY,
    governance.FAMILY,
    expressions.FAMILY,
    permissions.FAMILY,
    times.FAMILY,
    ros_nodes.FAMILY,
    stack_differences.FAMILY,
    cross.FAMILY,
    enclaves.FAMILY,
    signing.FAMILY,
    validity.FAMILY,
    trust.FAMILY,
    naming.FAMILY,
    subject_names.FAMILY,
    subject_encoding.FAMILY,
    size.FAMILY,
    post_quantum.FAMILY,
    files.FAMILY,
)

_ALL = sorted((rule for family in FAMILIES for rule in family.rules), key=lambda rule: rule.id)
RULES: dict[str, Rule] = {rule.id: rule for rule in _ALL}
"""By id, sorted."""


def rule_named(id_: str) -> Rule:
    """The rule with that id; UsageError if there is none."""
    try:
        return RULES[id_.upper()]
    except KeyError:
        raise UsageError(
            f"there is no rule {id_}",
            hint="docs/reference/rules.md lists all rules: PQS001 and so on",
        ) from None
