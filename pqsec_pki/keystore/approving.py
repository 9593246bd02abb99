"""The ledger's lines about approvals: whose are demanded, and who approved which plan.

The policy is in the ledger and in no other file: so it cannot be edited, and a line that is cut off
breaks a head that was noted elsewhere.
"""

import hashlib
from collections.abc import Iterable, Sequence
from datetime import datetime

from pqsec_pki.approvals import Approval, ApprovalPolicy, PlanProposal
from pqsec_pki.errors import MalformedError
from pqsec_pki.keystore._chain import Entry, Line
from pqsec_pki.keystore._ledger import Ledger

POLICY, PLAN, APPROVAL = "approvals", "plan", "approval"
"""Kinds of lines."""
_STATEMENT = "statement"


def policy_of(ledger: Ledger) -> ApprovalPolicy | None:
    """The newest policy; None if changes need no approvals. KeystoreError if it is damaged."""
    newest = ledger.newest(POLICY)
    return policy_in(newest[0]) if newest else None


def policy_in(entry: Entry) -> ApprovalPolicy | None:
    """The policy in a line of that kind; KeystoreError if that is damaged."""
    text = entry.details.get(_STATEMENT)
    if text == "":
        return None
    try:
        return ApprovalPolicy.from_text(str(text))
    except MalformedError as error:
        raise entry.damaged(str(error)) from error


def policy_entry(policy: ApprovalPolicy | None, head: str, now: datetime) -> Entry:
    """The line with the policy, None for no approvals; `head` makes it another line each time."""
    text = policy.text if policy else ""
    sha256 = hashlib.sha256(f"{head} {text}".encode()).hexdigest()
    details = {"rule": str(policy) if policy else "none are needed", _STATEMENT: text}
    return Entry.of(POLICY, "", sha256, now, details=details)


def approval_entries(
    proposal: PlanProposal, approvals: Iterable[Approval], now: datetime
) -> list[Entry]:
    """The line with which an approved plan begins, and one for each approval."""
    names = ", ".join(each.approver for each in approvals)
    details = {"approved by": names, "of": proposal.head}
    begins = Entry.of(PLAN, "", proposal.digest, now, details=details)
    return [begins, *(_approval_entry(each, now) for each in approvals)]


def _approval_entry(approval: Approval, now: datetime) -> Entry:
    details = {PLAN: approval.proposal, _STATEMENT: approval.to_file().decode()}
    return Entry.of(APPROVAL, approval.approver, approval.sha256, now, details=details)


def lines_since(lines: Sequence[Line], proposal: PlanProposal) -> Sequence[Line] | None:
    """The lines after the one with which the plan began; None if it has not begun."""
    begun = (number for number, line in enumerate(lines, 1) if _begins(line.entry, proposal))
    first = next(begun, None)
    return None if first is None else lines[first:]


def _begins(entry: Entry, proposal: PlanProposal) -> bool:
    return entry.kind == PLAN and entry.sha256 == proposal.digest
