"""Rehearses a migration on a copy of the keystore: every rollover, and handshakes between them."""

from datetime import datetime
from itertools import combinations, pairwise
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists
from pqsec_pki.algorithms import Profile
from pqsec_pki.credentials import ENCLAVES, KEY
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore, refuse_further_sets
from pqsec_pki.migration._temporary_folder import temporary_folder
from pqsec_pki.migration.generations import Generation, generations
from pqsec_pki.migration.meetings import Side, failure
from pqsec_pki.migration.planning import path_of
from pqsec_pki.selfcheck import PQSEC, CheckedStep, HandshakeSetup, JoinableDomains

SAMPLE = 6
"""Participants whose handshakes are run, if there are more: 15 pairs in each generation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RehearsedStep:
    """The result of one rollover on the copy."""

    profile: str
    reissued: int
    left_out: dict[str, str]
    succeeded: int
    """Pairs with new files that authenticated each other."""
    failures: tuple[str, ...]
    """The other pairs with new files, and why not."""
    old_with_new: int
    """Pairs of old and new files that authenticated each other."""
    old_with_new_refused: int
    reason: str
    """Why the first of those was refused; empty if none was."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rehearsal:
    """All rollovers of a migration on a copy."""

    participants: int
    """Participants with keys in the keystore: only they can be rehearsed."""
    sample: tuple[str, ...]
    """The participants whose handshakes ran."""
    steps: tuple[RehearsedStep, ...]

    @property
    def ok(self) -> bool:
        """Whether, after each step, there were pairs that share a domain, and all succeeded."""
        return all(each.succeeded and not each.failures for each in self.steps)


def rehearse(keystore: Keystore, target: Profile, *, now: datetime) -> Rehearsal:
    """Take a copy of the keystore through the profiles to `target`.

    The copy is in a folder that only its owner can read, and is removed, also if the process is
    killed. KeystoreError if fewer than two participants have their keys here; other errors of a
    rollover.
    """
    refuse_further_sets(keystore, "`pqsec migrate` changes")
    enclaves = keystore.folder / ENCLAVES
    names = [each for each in keystore.names() if exists(enclaves / each[1:] / KEY)]
    if len(names) < 2:  # noqa: PLR2004 -- a pair
        raise KeystoreError(
            "a rehearsal needs two participants whose keys are in the keystore",
            hint="rehearse with a keystore of two test participants: `pqsec demo`",
        )
    chosen = tuple(names[:: -(-len(names) // SAMPLE)])
    path = path_of(keystore.profile, target)
    steps = []
    with temporary_folder() as folder:
        for old, new in pairwise(generations(keystore, path, folder, now)):
            steps.append(_rehearsed(old, new, chosen, now))
    return Rehearsal(participants=len(names), sample=chosen, steps=tuple(steps))


class _Pair(NamedTuple):
    """Two participants, and a domain that both may join."""

    one: str
    other: str
    domain: int

    def failure(self, first: Keystore, second: Keystore, now: datetime) -> CheckedStep | None:
        """The step at which their handshake fails, with the files of these keystores."""
        one, other = Side(first, self.one, PQSEC), Side(second, self.other, PQSEC)
        return failure(one, other, self.domain, now)


def _rehearsed(
    old: Generation, new: Generation, names: tuple[str, ...], now: datetime
) -> RehearsedStep:
    plan = new.rollover
    reissued = (*plan.keeping, *plan.rekeyed) if plan else ()
    chosen = [each for each in names if each in reissued]
    pairs = [
        _Pair(one, other, domain)
        for one, other in combinations(chosen, 2)
        if (domain := _domain(new.keystore, one, other, now)) is not None
    ]
    same = {
        f"{each.one}, {each.other}": each.failure(new.keystore, new.keystore, now) for each in pairs
    }
    mixed = [
        each.failure(first, second, now)
        for each in pairs
        for first, second in ((old.keystore, new.keystore), (new.keystore, old.keystore))
    ]
    refused = [each for each in mixed if each]
    return RehearsedStep(
        profile=new.profile.name,
        reissued=len(reissued),
        left_out=dict(plan.left_out) if plan else {},
        succeeded=sum(each is None for each in same.values()),
        failures=tuple(
            f"{pair}: {each.name}: {each.detail}" for pair, each in same.items() if each
        ),
        old_with_new=len(mixed) - len(refused),
        old_with_new_refused=len(refused),
        reason=f"{refused[0].name}: {refused[0].detail}" if refused else "",
    )


def _domain(keystore: Keystore, one: str, other: str, now: datetime) -> int | None:
    setup = HandshakeSetup(keystore=keystore, domain=0, now=now)
    return min(JoinableDomains.of(setup, (one, other)).shared, default=None)
