"""Applies a plan that was approved: exactly its steps, each once, from the state it was made for.

The ledger gets a line for the plan and one for each approval before the first change. If the work
is interrupted, the same file continues it: the lines since then show which steps are done.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.approvals import Approval, Covered, PlanProposal, ProposedStep, refuse_without
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.planning import plan as make_plan
from pqsec_pki.domain.proposing import PlanReview, demanded_policy
from pqsec_pki.domain.steps import Plan, StepAction
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import (
    PLAN,
    Keystore,
    Line,
    SigningCa,
    approval_entries,
    change,
    lines_since,
)
from pqsec_pki.problems import Code

_LINES: Mapping[str, str] = {
    StepAction.CHANGE_PROFILE: "identity-ca",
    StepAction.ADD_SET: "identity-ca",
    StepAction.STORE_STOCK: "stock",
    StepAction.SIGN_GOVERNANCE: "governance",
    StepAction.ENROL: "participant",
    StepAction.ISSUE: "participant",
    StepAction.REPLACE: "participant",
    StepAction.RENEW: "participant",
    StepAction.SIGN_PERMISSIONS: "permissions",
    StepAction.REVOKE: "revocation",
    StepAction.RENEW_CRL: "crl",
    StepAction.STORE_APPROVALS: "approvals",
}
"""The kind of line that each step leaves in the ledger; groups leave none."""
_AGAIN = "make a new plan, and ask for new approvals"


@dataclass(frozen=True, slots=True)
class ApprovedPlan:
    """A plan with enough approvals, for the state in which the keystore is."""

    proposal: PlanProposal
    approvals: tuple[Approval, ...]
    keystore: Keystore
    plan: Plan
    """The steps that are left."""
    begun: bool

    def begin(self, now: datetime) -> "ApprovedPlan":
        """Enter plan and approvals in the ledger, unless they are there.

        The plan returned may be executed. VerificationError if the keystore has changed.
        """
        keystore = self.keystore
        approved = replace(self, keystore=replace(keystore, approved=True), begun=True)
        if self.begun:
            return approved
        with keystore.hold():
            refuse_other_state(self.proposal, keystore.head)
            with change(keystore.root) as transaction:
                transaction.record(*approval_entries(self.proposal, self.approvals, now))
            return replace(approved, plan=replace(self.plan, head=keystore.head))


def approved_plan(
    proposal: PlanProposal,
    approvals: Sequence[Approval],
    desired: Desired,
    keystore: Keystore,
    *,
    now: datetime,
) -> ApprovedPlan:
    """The plan, if these approvals are enough for it, and it fits the keystore and the file.

    VerificationError if not; KeystoreError if the keystore demands no approvals.
    """
    since = lines_since(keystore.lines(), proposal)
    left = proposal.steps if since is None else tuple(_left(proposal, since))
    if since is not None and not any(step.action in _LINES for step in left):
        raise VerificationError("the plan was applied already", hint="`pqsec log` shows it")
    proposal.refuse_expired(now)
    refuse_insufficient(proposal, approvals, keystore)
    if desired.sha256 != proposal.domain_sha256:
        raise changed_since(f"{desired.path} is not the file that the plan was made of")
    if since is None:
        refuse_other_state(proposal, keystore.head)
    if since is not None and any(line.entry.kind == PLAN for line in since):
        raise changed_since("another plan was begun after this one was interrupted")
    review = _reviewed(proposal, left, desired, keystore, now)
    if since is None and (review.rights, _needs(review)) != (proposal.rights, proposal.needs):
        raise changed_since("the rights that change are not those in the plan")
    return ApprovedPlan(proposal, tuple(approvals), keystore, review.plan, since is not None)


def refuse_insufficient(
    proposal: PlanProposal, approvals: Sequence[Approval], keystore: Keystore
) -> None:
    """VerificationError unless these are enough by the keystore's rule, which is the proposal's."""
    policy = demanded_policy(keystore, "`pqsec apply` takes the domain file")
    if policy != proposal.policy:
        raise changed_since(f"the plan was made for other approvals than the keystore's: {policy}")
    required = policy.required if proposal.needs else 1
    refuse_without(proposal.digest, policy, approvals, required=required)


def refuse_other_state(proposal: PlanProposal, head: str) -> None:
    """VerificationError if the ledger has another head than when the plan was made."""
    if head != proposal.head:
        raise changed_since("the keystore was changed since the plan was made")


def _left(proposal: PlanProposal, since: Sequence[Line]) -> Iterator[ProposedStep]:
    """The steps of which the ledger has no line yet: each is made once."""
    entries = [line.entry for line in since]
    # Each step has a line about the first set; of others, only those that begin them are counted:
    # adding one records all participants.
    done = {(each.kind, each.name) for each in entries if not each.set_name}
    of_cas = _LINES[StepAction.ADD_SET]
    done |= {(of_cas, each.set_name) for each in entries if each.kind == of_cas}
    for step in proposal.steps:
        if (_LINES.get(step.action), step.name) not in done:
            yield step


def _reviewed(
    proposal: PlanProposal,
    left: Sequence[ProposedStep],
    desired: Desired,
    keystore: Keystore,
    now: datetime,
) -> PlanReview:
    """What these steps would change now. VerificationError unless it is the same as planned."""
    only = next((ca for ca in SigningCa if ca.label == proposal.only), None)
    found = make_plan(
        desired, keystore, now=now, prune=proposal.prune, new_keys=proposal.new_keys, only=only
    )
    wanted = {(step.action, step.name) for step in left}
    steps = tuple(step for step in found.steps if (step.action, step.name) in wanted)
    review = PlanReview(desired, keystore, replace(found, steps=steps), now)
    if lost := set(left).symmetric_difference(review.steps):
        first = min(lost, key=lambda step: (step.action, step.name))
        what = f"{first.action} {first.name}".rstrip()
        raise changed_since(
            f"files were changed since the plan was made: '{what}' is another step now"
        )
    return review


def _needs(review: PlanReview) -> tuple[Covered, ...]:
    """The kinds of changes that need approvals."""
    policy = review.keystore.approvals
    return policy.needs(review.kinds) if policy else ()


def changed_since(words: str) -> VerificationError:
    """The error for a plan that no longer fits."""
    return VerificationError(words, code=Code.CONTENT_CHANGED, hint=_AGAIN)
