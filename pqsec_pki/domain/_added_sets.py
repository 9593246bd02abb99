"""Sets of credentials that a domain file names and the keystore does not have yet.

Each is added by one step, before all others: those are then about all sets.
"""

from collections.abc import Iterator, Sequence
from shlex import quote

from pqsec_pki.algorithms import Profile, profile_named
from pqsec_pki.domain.desired import Desired
from pqsec_pki.domain.steps import Blocked, Step, StepAction
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import Addable

_MOST = 5
"""Names in the reason of a step."""


def added_profiles(desired: Desired, keystore: Keystore) -> tuple[Profile, ...]:
    """The profiles of the sets that are to be added, in the order of the file.

    KeystoreError if the keystore has a set that the file does not name, or in another order.
    """
    there = tuple(each.name for each in keystore.profiles)
    named = desired.profiles or there
    if named[: len(there)] == there:
        return tuple(profile_named(each) for each in named[len(there) :])
    has = f"{desired.path} has {_said(named)}, but {keystore.root} has {_said(there)}"
    if len(there) == 1 and there[0] not in named:
        raise KeystoreError(
            has,
            hint="`pqsec ca rotate` changes the profile of a keystore; so does `pqsec apply`, if"
            f" the file has `migrate_from: {there[0]}`, and one profile",
        )
    if {*there} <= {*named}:
        more = (*there, *(each for each in named if each not in there))
        raise KeystoreError(
            f"{has}, in this order",
            hint=f"write `profile: [{', '.join(more)}]`: the first set is what stock stacks see,"
            " and others are added behind it",
        )
    raise KeystoreError(
        f"{has}: a set of credentials is not removed from a keystore",
        hint=f"write `profile: [{', '.join(there)}]`; or make another keystore with fewer sets:"
        f" `pqsec -k NEW apply {quote(str(desired.path))}`",
    )


def _said(names: Sequence[str]) -> str:
    return f"{'profile' if len(names) == 1 else 'profiles'} {', '.join(names)}"


def addition_steps(
    profiles: Sequence[Profile], found: Addable | None, keystore: Keystore
) -> Iterator[Step | Blocked]:
    """A step for each set; or, if something is in its way, what that is and no step."""
    if found is None:
        return
    for name, error in found.refused.items():
        why = f"is in the way of further sets: {error}"
        yield Blocked(name or "the keystore", why, error.hint or "restore that file")
    if found.refused:
        return
    before = [each.name for each in keystore.profiles]
    for profile in profiles:
        why = f"beside {', '.join(before)}: new CAs, and certificates for {_some(found.issued)}"
        if found.waiting:
            why += f"; not for {_some(found.waiting)}, whose keys are elsewhere"
        yield Step(StepAction.ADD_SET, profile.name, why)
        before.append(profile.name)


def _some(names: Sequence[str]) -> str:
    """How many participants, and the names of a few."""
    if len(names) <= _MOST:
        return ", ".join(names) or "no participant"
    return f"{len(names)} participants"
