"""Changes the profile of a keystore, if the domain file says from which profile.

All CAs and participants are replaced, so a plan with this change has no other step.
"""

from datetime import datetime

from pqsec_pki.algorithms import profile_named, protection_lost
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.steps import Blocked, Plan, Step, StepAction
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import (
    Rollover,
    RolloverPlan,
    apply_rollover,
    plan_rollover,
    refuse_keys_in_files,
)


def is_wanted(desired: Desired, keystore: Keystore) -> bool:
    """Whether the file has another profile, and says to change from the keystore's profile."""
    there = tuple(each.name for each in keystore.profiles)
    return bool(desired.profiles) and there == (desired.migrate_from,)


def plan_profile_change(desired: Desired, keystore: Keystore, *, now: datetime) -> Plan:
    """The plan, with this one step. Errors as of `plan_rollover`."""
    rollover = _rollover(desired, keystore, now)
    count = len(rollover.keeping) + len(rollover.rekeyed)
    why = (
        f"from {desired.migrate_from} to {desired.profiles[0]}: new CAs, and new certificates for"
        f" {count} participants"
    )
    lost = protection_lost(rollover.before, rollover.terms.profile)
    blocked = (
        Blocked(name, f"is not reissued: {reason}", "issue it again")
        for name, reason in rollover.left_out.items()
    )
    step = Step(StepAction.CHANGE_PROFILE, "", "; ".join((why, *lost)))
    return Plan((step,), tuple(blocked), (), 0, rollover.head)


def change_profile(  # noqa: PLR0913 -- by name
    desired: Desired,
    keystore: Keystore,
    plan: Plan,
    *,
    passphrase: bytes | None,
    compares_clock: bool = False,
    now: datetime,
) -> Keystore:
    """Execute such a plan; returns the keystore with its new profile.

    `passphrase` encrypts the keys of the new CAs; `compares_clock` is as in `Authorities`.
    KeystoreError if the keystore was changed since the plan was made; other errors as of
    `refuse_keys_in_files` and `apply_rollover`.
    """
    with keystore.hold():
        if keystore.head != plan.head:
            raise KeystoreError(
                "another command changed the keystore since the plan was made",
                hint="run the command again",
            )
        rollover = _rollover(desired, keystore, now)
        refuse_keys_in_files(keystore, rollover.terms)
        done = apply_rollover(
            keystore, rollover, passphrase=passphrase, compares_clock=compares_clock, now=now
        )
        return done.keystore


def _rollover(desired: Desired, keystore: Keystore, now: datetime) -> RolloverPlan:
    profile = profile_named(desired.profiles[0])
    terms = Rollover(profile=profile, validity=desired.ca_validity)
    return plan_rollover(keystore, terms, now=now)
