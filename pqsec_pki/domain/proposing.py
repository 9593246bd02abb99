"""The steps of a plan that need approvals, and the content that an approval covers.

A step has the hash of what it makes or ends, so that an approval is of these rights and this
certificate, and not only of words. The rights that change are beside them, for people to read.
"""

import hashlib
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from functools import cached_property
from os.path import relpath
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import days
from pqsec_pki.access import Difference, permissions_diff
from pqsec_pki.approvals import ApprovalPolicy, ChangedRights, Covered, PlanProposal, ProposedStep
from pqsec_pki.documents import Permissions
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.steps import Plan, Step, StepAction
from pqsec_pki.errors import KeystoreError, shown
from pqsec_pki.keystore import Keystore, groups_file
from pqsec_pki.lifecycle import (
    Addable,
    addable,
    changed_protection,
    changed_rights,
    grows,
    lasts_longer,
    revocable,
    widens_stock,
)

_KINDS = {
    StepAction.CHANGE_PROFILE: Covered.ROTATE,
    StepAction.ADD_SET: Covered.ROTATE,
    StepAction.ENROL: Covered.GROW,
    StepAction.ISSUE: Covered.GROW,
    StepAction.REPLACE: Covered.GROW,
    StepAction.REVOKE: Covered.REVOKE,
    StepAction.STORE_APPROVALS: Covered.APPROVALS,
}
"""The kinds of steps; those that sign documents or store stock names may be GROW, the rest is
OTHER."""


@dataclass(frozen=True)
class PlanReview:
    """What a plan changes, for those who approve it."""

    desired: Desired
    keystore: Keystore
    plan: Plan
    now: datetime

    @cached_property
    def kinds(self) -> frozenset[Covered]:
        """The kinds of its changes; one document that grows is enough for all that are signed.

        What is within an approved grant needs no more approvals.
        """
        steps = (step for step in self.plan.steps if not step.approved)
        found = {_KINDS.get(step.action, Covered.OTHER) for step in steps}
        if Covered.GROW not in found and self._grows():
            found.add(Covered.GROW)
        return frozenset(found)

    def _grows(self) -> bool:
        """Whether a step that may be GROW is."""
        stores = any(each.action is StepAction.STORE_STOCK for each in self.plan.steps)
        widens = stores and widens_stock(self.keystore, self.desired.stock)
        return widens or self._last_longer() or any(grows(each) for _, each in self._signed())

    @cached_property
    def steps(self) -> tuple[ProposedStep, ...]:
        """The steps, each with the hash of its content."""
        return tuple(
            ProposedStep(
                step.action,
                step.name,
                shown(step.why, len(step.why)),
                hashlib.sha256(self._content(step).encode()).hexdigest(),
            )
            for step in self.plan.steps
        )

    @cached_property
    def rights(self) -> tuple[ChangedRights, ...]:
        """The changes of rights, each with all who have it, and how long certificates last."""
        alike: dict[tuple[str, ...], list[str]] = {}
        of_sets = self._of_sets()
        for name, difference in (*self._issued(), *self._signed()):
            alike.setdefault(tuple(rights_words(difference)), []).append(name)
        for step in self.plan.steps:
            if step.keys:
                words = f"a certificate for the key with SHA-256 {step.keys}"
                alike.setdefault((words,), []).append(step.name)
        for name in self._named(StepAction.ISSUE, StepAction.REPLACE, StepAction.RENEW):
            words = f"{of_sets} valid for {days(self.desired.members[name].validity)}"
            alike.setdefault((words,), []).append(name)
        for name, words in (*self._in_added_sets(), *self._stock()):
            alike.setdefault((words,), []).append(name)
        return tuple(
            ChangedRights(tuple(filter(None, names)), changes) for changes, names in alike.items()
        )

    def _in_added_sets(self) -> Iterator[tuple[str, str]]:
        """Who gets a certificate of each set that is added."""
        for profile in self._named(StepAction.ADD_SET):
            for name in self._addable.issued:
                yield name, f"a certificate of set {profile}, as long as that of the first"

    def _stock(self) -> Iterator[tuple[str, str]]:
        """The names and patterns that are added and removed."""
        if any(each.action is StepAction.STORE_STOCK for each in self.plan.steps):
            before, after = {*self.keystore.stock}, {*self.desired.stock}
            for name in sorted(after - before):
                yield name, "may be met with the first set of credentials"
            for name in sorted(before - after):
                yield name, "may no longer be met with the first set of credentials"

    def _of_sets(self) -> str:
        """The beginning of words about certificates: they name all sets, if there are several."""
        names = [each.name for each in self.keystore.profiles]
        names += self._named(StepAction.ADD_SET)
        if len(names) == 1:
            return "a certificate that is"
        return f"certificates of all sets ({', '.join(names)}) that are"

    def _issued(self) -> Iterator[tuple[str, Difference]]:
        """The rights that come with certificates."""
        if self.plan.only:
            return
        for name in self._named(StepAction.ENROL, StepAction.ISSUE, StepAction.REPLACE):
            [grant] = self.desired.members[name].spec().grants
            yield name, permissions_diff(None, Permissions(grants=(grant,)))

    def _signed(self) -> Iterator[tuple[str, Difference]]:
        """Differences by participant; the governance has an empty name."""
        for name in self._named(StepAction.SIGN_GOVERNANCE):
            yield name, changed_protection(self.keystore, self.desired.governance)
        names = self._named(StepAction.SIGN_PERMISSIONS)
        if specs := [self.desired.members[name].spec() for name in names]:
            yield from changed_rights(self.keystore, specs, now=self.now)

    def _last_longer(self) -> bool:
        """Whether a renewed certificate would be for longer than before."""
        return any(
            lasts_longer(self.keystore, [name], self.desired.members[name].validity)
            for name in self._named(StepAction.RENEW)
        )

    def _named(self, *actions: StepAction) -> Iterator[str]:
        return (step.name for step in self.plan.steps if step.action in actions)

    def _content(self, step: Step) -> str:
        match step.action:
            case StepAction.ISSUE | StepAction.REPLACE | StepAction.RENEW:
                member = self.desired.members[step.name]
                return f"{member.config_digest} {member.validity.total_seconds()} {step.keys}"
            case StepAction.ENROL:
                return f"{self.desired.members[step.name].config_digest} {step.why} {step.keys}"
            case StepAction.SIGN_PERMISSIONS:
                return self.desired.members[step.name].config_digest
            case StepAction.REVOKE:
                return self._revoked[step.name]
            case _:
                return self._shared_content(step)

    def _shared_content(self, step: Step) -> str:
        """The content that a step makes, if it is not for one participant."""
        match step.action:
            case StepAction.SIGN_GOVERNANCE:
                return self.desired.governance_digest
            case StepAction.STORE_STOCK:
                return " ".join(self.desired.stock)
            case StepAction.ADD_SET:
                return self._added(step)
            case StepAction.STORE_GROUPS:
                return groups_file(self.desired.groups).decode()
            case StepAction.STORE_APPROVALS:
                return self.desired.approvals.text if self.desired.approvals else ""
            case _:
                return f"{step.why} {self.desired.ca_validity.total_seconds()}"

    def _added(self, step: Step) -> str:
        """Each certificate of the first set beside which there is to be one of the new set."""
        first = self.keystore.sets[0]
        issued = self._addable.issued
        with first.open_ledger() as ledger:
            found = {row[0]: row[1] for row in ledger.participants(issued)}
        of = " ".join(found[name] for name in issued)
        return f"{step.name} {step.why} {self.desired.ca_validity.total_seconds()} {of}"

    @cached_property
    def _addable(self) -> Addable:
        return addable(self.keystore, now=self.now)

    @cached_property
    def _revoked(self) -> Mapping[str, str]:
        """SHA-256 of the newest certificate of each participant that is revoked.

        That of the first set: it has one of each other set, also of one that the plan adds.
        """
        names = [*self._named(StepAction.REVOKE)]
        found = revocable(self.keystore, names, now=self.now)
        return {each.name: each.sha256 for each in found if not each.set_name}


def rights_words(difference: Difference) -> Iterator[str]:
    """The changes, in words for those who approve them."""
    for change in difference.changes:
        words = f"{change.sense}: {change.text}"
        yield shown(words, len(words))
    if not difference.complete:
        yield "not all can be compared: there may be more"


def demanded_policy(keystore: Keystore, hint: str) -> ApprovalPolicy:
    """The keystore's policy of approvals; KeystoreError, with the hint, if it demands none."""
    if policy := keystore.approvals:
        return policy
    raise KeystoreError(f"{keystore.root} demands no approvals", hint=hint)


def refuse_unapproved(desired: Desired, keystore: Keystore, plan: Plan, *, now: datetime) -> None:
    """KeystoreError if some of the plan's changes need approvals; before any is made."""
    policy = None if keystore.approved else keystore.approvals
    if policy:
        policy.refuse(PlanReview(desired, keystore, plan, now).kinds)


def propose(  # noqa: PLR0913 -- each is a choice of the user's, and all by name
    review: PlanReview,
    *,
    proposer: str,
    prune: bool,
    new_keys: bool,
    validity: timedelta,
    beside: Path,
) -> PlanProposal:
    """The plan as a proposal, for a file in the folder `beside`.

    KeystoreError if the keystore demands no approvals.
    """
    hint = "`pqsec apply` makes the changes; `approvals` in the domain file demands some"
    policy, now = demanded_policy(review.keystore, hint), review.now.replace(microsecond=0)
    return PlanProposal(
        proposer=proposer,
        made_at=now,
        expires=now + validity,
        domain_file=relpath(review.desired.path, beside),
        domain_sha256=review.desired.sha256,
        head=review.plan.head or review.keystore.head,
        policy=policy,
        needs=policy.needs(review.kinds),
        prune=prune,
        new_keys=new_keys,
        only=review.plan.only.label if review.plan.only else "",
        steps=review.steps,
        rights=review.rights,
    )
