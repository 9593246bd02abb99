"""Executes the steps of a plan in batches; each batch is one atomic change of the keystore.

If it is killed, a new plan has the steps that are left.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from itertools import groupby
from pathlib import Path

from pqsec_pki.domain._profile_change import change_profile
from pqsec_pki.domain._step_runner import StepRunner
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.planning import plan as make_plan
from pqsec_pki.domain.planning import profiles_of
from pqsec_pki.domain.proposing import refuse_unapproved
from pqsec_pki.domain.steps import Plan, Step, StepAction
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Authorities, Keystore

BATCH = 500
"""Participants in one change: enough to make its overhead small, and the most that is lost
when pqsec is killed."""

_WHOLE = {StepAction.ENROL, StepAction.REVOKE}
"""One change for all: an order is performed whole, and one revocation list is issued."""


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
    cas = keystore.unlock(passphrase)
    batches = apply_plan(desired, keystore, cas, found, passphrase=passphrase, now=now)
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
    return Keystore.create(
        root,
        *profiles_of(desired),
        name=desired.name,
        domains=desired.domains,
        validity=desired.ca_validity,
        passphrase=passphrase,
        gitignore=True,
        now=now,
    )


def apply_plan(  # noqa: PLR0913 -- the last by name
    desired: Desired,
    keystore: Keystore,
    authorities: Authorities,
    plan: Plan,
    *,
    passphrase: bytes | None = None,
    now: datetime,
) -> Iterator[Sequence[Step]]:
    """Execute the steps except the creation of the keystore; yields the steps of each batch.

    `passphrase` is that of the CA keys: those of a further set are encrypted under it, too.
    Steps that another command has done since the plan was made are skipped. Yielded steps are
    done, even if a later batch fails. A participant that fails does not stop the others; its
    error is raised at the end. Errors as of the keystore's operations. If a set was added,
    `keystore` lacks it: open it again.
    """
    runner = StepRunner(desired, keystore, authorities, plan, now, passphrase)
    for action, group in groupby(plan.steps, key=lambda step: step.action):
        for steps in runner.alike(action, group):
            size = len(steps) if action in _WHOLE else BATCH
            for start in range(0, len(steps), size):
                yield from runner.batch(action, steps[start : start + size])
    runner.raise_failures()
