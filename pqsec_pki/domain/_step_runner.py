"""Executes batches of steps of a plan; each is one atomic change of the keystore."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Reason
from pqsec_pki.domain._orders import order_at, steps_of
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.planning import plan as make_plan
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
    add_set,
    issue,
    renew,
    renew_list,
    revoke,
    sign_governance,
    sign_permissions,
    store_approvals,
    store_groups,
    store_stock,
)

MAX_FAILURES = 10
"""Failing participants; if more fail, the participants are not the cause."""

_OWN_FAULTS = (InvalidDocumentError, KeystoreError, MalformedError, UsageError, VerificationError)
"""Errors that a participant may cause, unlike errors of the disk."""


class StepRunner:
    """Executes batches of steps with the same action."""

    def __init__(  # noqa: PLR0913, PLR0917 -- what a change needs
        self,
        desired: Desired,
        keystore: Keystore,
        authorities: Authorities,
        plan: Plan,
        now: datetime,
        passphrase: bytes | None,
    ) -> None:
        self._desired = desired
        self._keystore = keystore
        self._authorities = authorities
        self._now = now
        self._passphrase = passphrase
        self._wanted = {(step.action, step.name) for step in plan.steps}
        self._whole = plan.only is None
        self._head = plan.head or keystore.head
        self._failures: list[PqsecError] = []

    def alike(self, action: StepAction, steps: Iterable[Step]) -> Iterable[list[Step]]:
        """Group the steps for one change each: renewals with one validity, one order, one set."""
        if action is StepAction.ADD_SET:
            return [[step] for step in steps]
        if action not in {StepAction.RENEW, StepAction.ENROL}:
            return [list(steps)]
        found: dict[object, list[Step]] = {}
        for step in steps:
            member = self._desired.members[step.name]
            shared = member.request if action is StepAction.ENROL else member.validity
            found.setdefault(shared, []).append(step)
        return found.values()

    def batch(self, action: StepAction, steps: Sequence[Step]) -> Iterator[Sequence[Step]]:
        """Execute all steps in one change; if some fail, execute the others without them."""
        steps, error = self._try(action, steps)
        if error is None:
            yield steps
        elif not steps[0].participant or len(self._failures) == MAX_FAILURES:
            raise error
        elif len(steps) == 1 or action is StepAction.ENROL:
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
        members = self._desired.members
        match action:
            case StepAction.CREATE_CAS | StepAction.CHANGE_PROFILE:
                pass  # done before, because the CAs come from there
            case StepAction.ADD_SET:
                self._add_set(names[0])
            case StepAction.ENROL | StepAction.ISSUE | StepAction.REPLACE:
                self._issue(action, steps)
            case StepAction.SIGN_PERMISSIONS:
                sign_permissions(*at, [members[name].spec() for name in names], now=self._now)
            case StepAction.RENEW:
                self._renew(names)
            case StepAction.REVOKE:
                revoke(*at, names, reason=Reason.CESSATION_OF_OPERATION, now=self._now)
            case _:
                self._take_shared(action)

    def _take_shared(self, action: StepAction) -> None:
        """Execute a step that is for no participant and no set."""
        at, desired = (self._keystore, self._authorities), self._desired
        match action:
            case StepAction.SIGN_GOVERNANCE:
                digest = desired.governance_digest
                sign_governance(*at, desired.governance, now=self._now, config_digest=digest)
            case StepAction.STORE_GROUPS:
                store_groups(self._keystore, desired.groups)
            case StepAction.STORE_STOCK:
                store_stock(*at, desired.stock, now=self._now)
            case StepAction.RENEW_CRL:
                renew_list(*at, now=self._now)
            case StepAction.STORE_APPROVALS:
                store_approvals(*at, desired.approvals, now=self._now)

    def _add_set(self, profile: str) -> None:
        """Add it, and change all sets from then on."""
        added = add_set(
            self._keystore,
            self._authorities,
            profile_named(profile),
            validity=self._desired.ca_validity,
            passphrase=self._passphrase,
            now=self._now,
        )
        self._keystore, self._authorities = added.keystore.sets[0], added.authorities

    def _issue(self, action: StepAction, steps: Sequence[Step]) -> None:
        if action is StepAction.ENROL:
            self._enrol(steps)
            return
        members, profiles = self._desired.members, self._keystore.profiles
        specs = [spec_of(members[step.name], profiles, step.keys) for step in steps]
        if not self._whole:  # who signs the permissions sees by the digest that they are missing
            specs = [replace(spec, config_digest="") for spec in specs]
        issue(
            self._keystore,
            self._authorities,
            specs,
            now=self._now,
            force=action is StepAction.REPLACE,
            sign_permissions=self._whole,
        )

    def _enrol(self, steps: Sequence[Step]) -> None:
        """Perform an order; VerificationError if it is another one than when the plan was made."""
        path = self._desired.members[steps[0].name].request
        if path is None:
            raise ValueError("only participants with an order are enrolled")
        found = order_at(path, self._desired.members, self._keystore, now=self._now)
        if _words(steps_of(found)) != _words(steps):
            raise VerificationError(
                f"{path}: it is another order than when the plan was made",
                hint="apply again, and check who else can write there",
            )
        records = [found.line]
        issue(found.keystore, self._authorities, found.specs, now=self._now, records=records)

    def _renew(self, names: list[str]) -> None:
        validity = self._desired.members[names[0]].validity
        due = self._desired.renew_before
        terms = Renewal(validity=validity, due=due, sign_permissions=self._whole)
        renew(self._keystore, self._authorities, names, terms, now=self._now)


def _words(steps: Iterable[Step]) -> set[tuple[str, str, str]]:
    return {(step.name, step.why, step.keys) for step in steps}
