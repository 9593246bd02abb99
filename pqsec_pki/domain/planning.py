"""Compares a domain file with a keystore: the steps that bring the keystore into that state.

It reads the ledger, the files' inodes and times, and requests. It parses the documents of
participants whose config digest differs, and no others.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.algorithms import DEFAULT_PROFILE, Profile, profile_named
from pqsec_pki.approvals import ApprovalPolicy
from pqsec_pki.domain._added_sets import added_profiles, addition_steps
from pqsec_pki.domain._profile_change import is_wanted, plan_profile_change
from pqsec_pki.domain._reconcile import Reconciler
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.steps import Blocked, Ended, Plan, Step, StepAction
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import (
    Keystore,
    Overlap,
    SigningCa,
    State,
    Status,
    governance_digest,
    signed_governance,
    status,
)
from pqsec_pki.lifecycle import addable

_TWO_CAS = "is not in the file, and nobody can be revoked while two identity CAs are trusted"
_NEEDED_CA = {
    StepAction.SIGN_GOVERNANCE: SigningCa.PERMISSIONS,
    StepAction.STORE_GROUPS: SigningCa.PERMISSIONS,
    StepAction.ISSUE: SigningCa.IDENTITY,
    StepAction.REPLACE: SigningCa.IDENTITY,
    StepAction.SIGN_PERMISSIONS: SigningCa.PERMISSIONS,
    StepAction.RENEW: SigningCa.IDENTITY,
    StepAction.REVOKE: SigningCa.IDENTITY,
    StepAction.RENEW_CRL: SigningCa.IDENTITY,
    StepAction.STORE_STOCK: SigningCa.PERMISSIONS,
    StepAction.STORE_APPROVALS: SigningCa.PERMISSIONS,
}
"""Other steps need both CAs: orders are performed whole, and CAs are made and replaced together.
So are those of a further set."""
_MOST_GROUPS = 5
"""In the reason of a step."""
_PLACE = {action: place for place, action in enumerate(StepAction)}


def plan(  # noqa: PLR0913 -- the choices are the user's, and by name
    desired: Desired,
    keystore: Keystore | None,
    *,
    now: datetime,
    prune: bool = False,
    new_keys: bool = False,
    only: SigningCa | None = None,
) -> Plan:
    """The steps from the keystore, None if there is none yet, to the desired state.

    `prune` has the same effect as in the file. `new_keys` allows requests for other keys than
    the participant had. With `only`, the plan has the steps that need that CA's keys, and new
    certificates come without permissions: a plan of the other part signs them, where the keystore
    was carried. KeystoreError if the keystore has another name, another profile that the file does
    not change, or a set of credentials that the file does not name; and with `only` if there is
    none.
    """
    if only:
        if keystore is None:
            hint = "`pqsec apply` without --only creates it, with the keys of both CAs"
            raise KeystoreError("there is no keystore yet", hint=hint)
        return _part(plan(desired, keystore, now=now, prune=prune, new_keys=new_keys), only)
    if keystore is None:
        return _from_nothing(desired)
    if is_wanted(desired, keystore):
        _refuse_another_name(desired, keystore)
        return plan_profile_change(desired, keystore, now=now)
    adding = added_profiles(desired, keystore)
    _refuse_another_name(desired, keystore)
    actual = status(keystore, now=now, due=desired.renew_before, compare_files=True)
    found = addable(keystore, now=now) if adding else None
    can_add = found is not None and not found.refused
    reconciler = Reconciler(
        profiles=(*keystore.profiles, *(adding if can_add else ())),
        keystore=keystore,
        ca_ends=min(each.identity_ca.not_after for each in keystore.sets),
        now=now,
        new_keys=new_keys,
        members=desired.members,
        added=frozenset(found.issued) if found else frozenset(),
    )
    planner = _Planner(desired, keystore, actual, reconciler, now, prune or desired.prune)
    return planner.plan(list(addition_steps(adding, found, keystore)))


def _part(whole: Plan, only: SigningCa) -> Plan:
    """The steps that need the keys of this CA alone."""
    steps = tuple(step for step in whole.steps if _NEEDED_CA.get(step.action) is only)
    left = tuple(step for step in whole.steps if step not in steps)
    return replace(whole, steps=steps, left=left, only=only)


def _from_nothing(desired: Desired) -> Plan:
    reconciler = Reconciler(profiles_of(desired))
    found = [each for member in desired.members.values() for each in reconciler.of(member, None)]
    steps = [
        Step(StepAction.CREATE_CAS, "", "there is no keystore"),
        Step(StepAction.SIGN_GOVERNANCE, "", "there is no keystore"),
        *([Step(StepAction.STORE_GROUPS, "", _counted(desired))] if desired.groups else []),
        *([_stock_step(desired)] if desired.stock else []),
        *(each for each in found if isinstance(each, Step)),
        *([_approvals_step(desired)] if desired.approvals else []),
    ]
    return Plan(tuple(steps), tuple(each for each in found if isinstance(each, Blocked)), (), 0)


def profiles_of(desired: Desired) -> tuple[Profile, ...]:
    """The profiles of a new keystore."""
    return tuple(map(profile_named, desired.profiles)) or (DEFAULT_PROFILE,)


def _refuse_another_name(desired: Desired, keystore: Keystore) -> None:
    subject = keystore.identity_ca.subject_name
    if desired.name and f"CN={desired.name} " not in subject:
        raise KeystoreError(
            f"{desired.path} has the name {desired.name}, but the CA of {keystore.root} is"
            f" {subject}",
            hint="name the right keystore with -k, or remove `name` from the file",
        )


def _approvals_step(desired: Desired, before: ApprovalPolicy | None = None) -> Step:
    """The step; who approves it sees whose key is another one, though the names are the same."""
    rule = desired.approvals
    other = rule.other_keys(before) if rule and before else ()
    why = f"{rule}; another key of {', '.join(other)}" if other else str(rule or "none are needed")
    return Step(StepAction.STORE_APPROVALS, "", why)


def _stock_step(desired: Desired) -> Step:
    """The step; it names all, because they are what is decided."""
    return Step(StepAction.STORE_STOCK, "", ", ".join(desired.stock) or "nobody")


def _counted(desired: Desired) -> str:
    """The reason of the step that stores groups: each group and its number of members."""
    sizes = [f"@{key}: {len(names)}" for key, names in desired.groups.items()]
    rest = [f"{len(sizes) - _MOST_GROUPS} more"] if len(sizes) > _MOST_GROUPS else []
    return ", ".join(sizes[:_MOST_GROUPS] + rest) or "the file has none"


@dataclass(frozen=True, slots=True)
class _Planner:
    desired: Desired
    keystore: Keystore
    actual: Status
    reconciler: Reconciler
    now: datetime
    prune: bool

    def plan(self, addition: Sequence[Step | Blocked]) -> Plan:
        steps = [each for each in addition if isinstance(each, Step)]
        blocked = [each for each in addition if isinstance(each, Blocked)]
        ended: list[Ended] = []
        unchanged = 0
        if why := self._why_sign_governance():
            steps.append(Step(StepAction.SIGN_GOVERNANCE, "", why))
        held = {each.name: each for each in self.actual.participants}
        for member in self.desired.members.values():
            found = list(self.reconciler.of(member, held.get(member.name)))
            steps += [each for each in found if isinstance(each, Step)]
            blocked += [each for each in found if isinstance(each, Blocked)]
            ended += [each for each in found if isinstance(each, Ended)]
            unchanged += not found
        others = self._others()
        if self._has_other_groups(others):
            steps.append(Step(StepAction.STORE_GROUPS, "", _counted(self.desired)))
        if self.keystore.stock != self.desired.stock:
            steps.append(_stock_step(self.desired))
        if self.prune:
            overlap = next(filter(None, map(Overlap.of, self.keystore.sets)), None)
            if overlap:
                blocked += [Blocked(name, _TWO_CAS, overlap.next_step) for name in others]
            else:
                steps += [Step(StepAction.REVOKE, name, "not in the file") for name in others]
        steps += self._list_steps(steps)
        before = self.keystore.approvals
        if before != self.desired.approvals:
            steps.append(_approvals_step(self.desired, before))
        steps.sort(key=lambda step: _PLACE[step.action])
        unlisted = () if self.prune else others
        head, gone = self.actual.head, tuple(ended)
        return Plan(tuple(steps), tuple(blocked), unlisted, unchanged, head, ended=gone)

    def _why_sign_governance(self) -> str:
        return next(filter(None, map(self._why_sign, self.keystore.sets)), "")

    def _why_sign(self, keystore: Keystore) -> str:
        """Why the governance of one set is signed."""
        config_digest = governance_digest(keystore)
        if config_digest is None:
            return "the file is not the one signed last"
        if config_digest == self.desired.governance_digest:
            return ""
        if not config_digest and signed_governance(keystore) == self.desired.governance:
            return ""  # signed by another command, with the same content
        return "it was changed" if config_digest else "its content differs"

    def _has_other_groups(self, others: Iterable[str]) -> bool:
        """Whether the keystore has other groups; participants without credentials do not count.

        Groups that cannot be read are written again.
        """
        counted = self.desired.members.keys() | set(others)
        try:
            stored = self.keystore.groups
        except KeystoreError:
            return True
        left = {
            key: found
            for key, names in stored.items()
            if (found := tuple(name for name in names if name in counted))
        }
        return left != self.desired.groups

    def _others(self) -> tuple[str, ...]:
        """The participants with a valid certificate that are not in the file."""
        return tuple(
            sorted(
                held.name
                for held in self.actual.participants
                if held.name not in self.desired.members
                and not (held.revoked or held.issued_by_previous_ca)
                and held.not_after >= self.now
            )
        )

    def _list_steps(self, steps: list[Step]) -> list[Step]:
        """The step that renews the list; renewing and revoking include it."""
        included = any(step.action in {StepAction.RENEW, StepAction.REVOKE} for step in steps)
        crl = self.actual.revocation_list
        if included or crl is None or not self.actual.list_is_due:
            return []
        early = crl.state is State.NOT_YET_VALID
        why = "is not valid yet: a clock was wrong" if early else f"ends {said(crl.not_after)}"
        if crl.state is State.GONE:
            why = f"that of set {crl.set_name} is missing"
        return [Step(StepAction.RENEW_CRL, "", why)]
