"""Executes the steps of a plan in batches; each batch is one atomic change of the keystore.

If it is killed, a new plan has the steps that are left.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import groupby
from pathlib import Path

from pqsec_pki.algorithms import DEFAULT_PROFILE, profile_named
from pqsec_pki.certificates import Reason
from pqsec_pki.domain._profile_change import change_profile
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.planning import plan as make_plan
from pqsec_pki.domain.proposing import refuse_unapproved
from pqsec_pki.domain.requests import spec_of
from pqsec_pki.domain.steps import Plan, Step, StepAction
from pqsec_pki.errors import (
    InvalidDocumentError,
    KeystoreError,
    MalformedError,
    PqsecError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import Authorities, Keystore
from pqsec_pki.lifecycle import (
    Renewal,
    issue,
    renew,
    renew_list,
    revoke,
    sign_governance,
    sign_permissions,
    store_approvals,
    store_groups,
)

BATCH = 500
"""Participants in one change: enough to make its overhead small, and the most that is lost
when pqsec is killed."""

MAX_FAILURES = 10
"""Failing participants; if more fail, the participants are not the cause."""

_OWN_FAULTS = (InvalidDocumentError, KeystoreError, MalformedError, UsageError, VerificationError)
"""Errors that a participant may cause, unlike errors of the disk."""


def apply(  # noqa: PLR0913 -- the choices are the user's, and by name
    desired: Desired,
    root: Path,
    *,
    passphrase: bytes | None,
    now: datetime,
    prune: bool = False,
    new_keys: bool = False,
    revoke_most: bool = False,
) -> Plan:
    """Bring the keystore at `root` into the desired state; create it if there is none.

    Returns the plan with the steps that were executed; it also has the participants that stay
    blocked. `passphrase` encrypts or encrypted the CA keys; None if they are not encrypted.
    After a change of the profile, call it again for the other changes.
    `prune` and `new_keys` as in `plan`, `revoke_most` as in `refuse_mass_revocation`; other
    errors as of `Keystore.open`, `plan` and `apply_plan`.
    """
    keystore = Keystore.find(root, to_change=True)
    found = make_plan(desired, keystore, now=now, prune=prune, new_keys=new_keys)
    if not found.steps:
        return found
    if keystore:
        refuse_unapproved(desired, keystore, found, now=now)
    if keystore and found.changes_profile:
        change_profile(desired, keystore, found, passphrase=passphrase, now=now)
        return found
    if not revoke_most:
        refuse_mass_revocation(desired, found)
    keystore = keystore or create_keystore(desired, root, passphrase=passphrase, now=now)
    batches = apply_plan(desired, keystore, keystore.unlock(passphrase), found, now=now)
    return replace(found, steps=tuple(step for batch in batches for step in batch))


def refuse_mass_revocation(desired: Desired, plan: Plan) -> None:
    """UsageError if the plan revokes more participants than the file names.

    A truncated list would revoke a fleet, and revocations cannot be undone.
    """
    if plan.revoked > len(desired.members):
        raise UsageError(
            f"{plan.revoked} participants would be revoked, and {desired.path} names"
            f" {len(desired.members)}",
            hint="check that no list in the file is truncated; to do it, use --revoke-most",
        )


def create_keystore(
    desired: Desired, root: Path, *, passphrase: bytes | None, now: datetime
) -> Keystore:
    """Create a keystore with the desired CAs: the first step of a plan without a keystore.

    ExistsError if `root` has any part of a keystore.
    """
    profile = profile_named(desired.profile) if desired.profile else DEFAULT_PROFILE
    return Keystore.create(
        root,
        profile,
        name=desired.name,
        domains=desired.domains,
        validity=desired.ca_validity,
        passphrase=passphrase,
        now=now,
    )


def apply_plan(
    desired: Desired, keystore: Keystore, authorities: Authorities, plan: Plan, *, now: datetime
) -> Iterator[Sequence[Step]]:
    """Execute the steps except the creation of the keystore; yields the steps of each batch.

    Steps that another command has done since the plan was made are skipped. Yielded steps are
    done, even if a later batch fails. A participant that fails does not stop the others; its
    error is raised at the end. Errors as of the keystore's operations.
    """
    worker = _Worker(desired, keystore, authorities, plan, now)
    for action, group in groupby(plan.steps, key=lambda step: step.action):
        for steps in worker.alike(action, group):
            size = (
                len(steps) if action is StepAction.REVOKE else BATCH
            )  # one revocation list for all
            for start in range(0, len(steps), size):
                yield from worker.batch(action, steps[start : start + size])
    worker.raise_failures()


class _Worker:
    """Executes batches of steps with the same action."""

    def __init__(
        self,
        desired: Desired,
        keystore: Keystore,
        authorities: Authorities,
        plan: Plan,
        now: datetime,
    ) -> None:
        self._desired = desired
        self._keystore = keystore
        self._authorities = authorities
        self._now = now
        self._wanted = {(step.action, step.name) for step in plan.steps}
        self._head = plan.head or keystore.head
        self._failures: list[PqsecError] = []

    def alike(self, action: StepAction, steps: Iterable[Step]) -> Iterable[list[Step]]:
        """Group the steps for one change each: renewals in a change have the same validity."""
        if action is not StepAction.RENEW:
            return [list(steps)]
        found: dict[timedelta, list[Step]] = {}
        for step in steps:
            found.setdefault(self._desired.members[step.name].validity, []).append(step)
        return found.values()

    def batch(self, action: StepAction, steps: Sequence[Step]) -> Iterator[Sequence[Step]]:
        """Execute all steps in one change; if some fail, execute the others without them."""
        steps, error = self._try(action, steps)
        if error is None:
            yield steps
        elif not steps[0].name or len(self._failures) == MAX_FAILURES:
            raise error
        elif len(steps) == 1:
            self._failures.append(error)
        else:
            half = len(steps) // 2
            yield from self.batch(action, steps[:half])
            yield from self.batch(action, steps[half:])

    def _try(
        self, action: StepAction, steps: Sequence[Step]
    ) -> tuple[Sequence[Step], PqsecError | None]:
        """Execute the steps that are still needed; returns them, and the error if one failed.

        The lock keeps other commands from changing the keystore between check and change.
        """
        with self._keystore.hold():
            if self._keystore.head != self._head:
                self._update_plan()
            steps = [step for step in steps if (step.action, step.name) in self._wanted]
            try:
                if steps:
                    self.take(action, steps)
            except _OWN_FAULTS as error:
                return steps, error
            finally:
                self._head = self._keystore.head
        return steps, None

    def _update_plan(self) -> None:
        """Drop the steps that another command has done meanwhile."""
        self._authorities.refuse_outdated(self._keystore.root)
        prune = any(action is StepAction.REVOKE for action, _ in self._wanted)
        found = make_plan(self._desired, self._keystore, now=self._now, prune=prune, new_keys=True)
        self._wanted &= {(step.action, step.name) for step in found.steps} | {
            (StepAction.CREATE_CAS, "")
        }

    def raise_failures(self) -> None:
        """Raise the error of the failed participant; KeystoreError if several failed."""
        if not self._failures:
            return
        first, *others = self._failures
        if not others:
            raise first
        raise KeystoreError(
            f"{len(self._failures)} participants failed; the first: {first}",
            hint=first.hint,
        )

    def take(self, action: StepAction, steps: Sequence[Step]) -> None:
        """Execute the steps in one change, all or none."""
        at = (self._keystore, self._authorities)
        names = [step.name for step in steps]
        members, profile = self._desired.members, self._keystore.profile
        match action:
            case StepAction.CREATE_CAS | StepAction.CHANGE_PROFILE:
                pass  # done before, because the CAs come from there
            case StepAction.SIGN_GOVERNANCE:
                config_digest = self._desired.governance_digest
                sign_governance(
                    *at, self._desired.governance, now=self._now, config_digest=config_digest
                )
            case StepAction.STORE_GROUPS:
                store_groups(self._keystore, self._desired.groups)
            case StepAction.ISSUE | StepAction.REPLACE:
                specs = [spec_of(members[step.name], profile, step.keys) for step in steps]
                issue(*at, specs, now=self._now, force=action is StepAction.REPLACE)
            case StepAction.SIGN_PERMISSIONS:
                sign_permissions(*at, [members[name].spec() for name in names], now=self._now)
            case StepAction.RENEW:
                self._renew(names)
            case StepAction.REVOKE:
                revoke(*at, names, reason=Reason.CESSATION_OF_OPERATION, now=self._now)
            case StepAction.RENEW_CRL:
                renew_list(*at, now=self._now)
            case StepAction.STORE_APPROVALS:
                store_approvals(*at, self._desired.approvals, now=self._now)

    def _renew(self, names: list[str]) -> None:
        validity = self._desired.members[names[0]].validity
        terms = Renewal(validity=validity, due=self._desired.renew_before)
        renew(self._keystore, self._authorities, names, terms, now=self._now)
