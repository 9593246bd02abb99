"""The ledger's lines about approvals: whose are demanded, and who approved which plan.

The policy is in the ledger and in no other file: so it cannot be edited, and a line that is cut off
breaks a head that was noted elsewhere.
"""

import hashlib
from collections.abc import Iterable, Sequence
from datetime import datetime

from pqsec_pki.approvals import Approval, ApprovalPolicy, PlanProposal
from pqsec_pki.errors import KeystoreError, MalformedError
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
        raise KeystoreError(
            f"the ledger's line on approvals is damaged ({error})",
            hint="`pqsec log --verify` shows which lines were altered",
        ) from error


def policy_entry(policy: ApprovalPolicy | None, head: str, now: datetime) -> Entry:
    """The line with the policy, None for no approvals; `head` makes it another line each time."""
    text = policy.text if policy else ""
    return Entry(
        at=now.isoformat(timespec="seconds"),
        kind=POLICY,
        name="",
        serial=None,
        sha256=hashlib.sha256(f"{head} {text}".encode()).hexdigest(),
        not_after=None,
        details={"rule": str(policy) if policy else "none are needed", _STATEMENT: text},
    )


def approval_entries(
    proposal: PlanProposal, approvals: Iterable[Approval], now: datetime
) -> list[Entry]:
    """The line with which an approved plan begins, and one for each approval."""
    at, names = now.isoformat(timespec="seconds"), [each.approver for each in approvals]
    begins = Entry(
        at=at,
        kind=PLAN,
        name="",
        serial=None,
        sha256=proposal.digest,
        not_after=None,
        details={"approved by": ", ".join(names), "of": proposal.head},
    )
    return [begins, *(_approval_entry(each, at) for each in approvals)]


def _approval_entry(approval: Approval, at: str) -> Entry:
    return Entry(
        at=at,
        kind=APPROVAL,
        name=approval.approver,
        serial=None,
        sha256=approval.sha256,
        not_after=None,
        details={PLAN: approval.proposal, _STATEMENT: approval.to_file().decode()},
    )


def lines_since(lines: Sequence[Line], proposal: PlanProposal) -> Sequence[Line] | None:
    """The lines after the one with which the plan began; None if it has not begun."""
    begun = (number for number, line in enumerate(lines, 1) if _begins(line.entry, proposal))
    first = next(begun, None)
    return None if first is None else lines[first:]


def _begins(entry: Entry, proposal: PlanProposal) -> bool:
    return entry.kind == PLAN and entry.sha256 == proposal.digest
