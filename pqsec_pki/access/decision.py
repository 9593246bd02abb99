"""The answer to a question about access."""

from dataclasses import dataclass

from pqsec_pki.documents import DomainRule, Grant, Rule


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """Yes or no, and why.

    `decided_by` is the part of a document that decided: a rule, or a grant by its
    validity or its default; None where the lack of a part did.
    """

    allowed: bool
    reason: str
    decided_by: DomainRule | Grant | Rule | None = None


def yes(reason: str, by: DomainRule | Grant | Rule) -> Decision:
    return Decision(allowed=True, reason=reason, decided_by=by)


def no(reason: str, by: DomainRule | Grant | Rule | None = None) -> Decision:
    return Decision(allowed=False, reason=reason, decided_by=by)
