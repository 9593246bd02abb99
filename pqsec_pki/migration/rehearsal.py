"""Rehearses a migration on a copy of the keystore: every rollover, and handshakes between them."""

from collections.abc import Sequence
from datetime import datetime
from itertools import combinations, pairwise
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists
from pqsec_pki.algorithms import Profile
from pqsec_pki.credentials import ENCLAVES, KEY
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore
from pqsec_pki.migration._temporary_folder import temporary_folder
from pqsec_pki.migration.additions import Addition, additions
from pqsec_pki.migration.generations import Generation, generations
from pqsec_pki.migration.meetings import Side, failure
from pqsec_pki.migration.planning import path_of, refuse_several
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
    refuse_several(keystore)
    names, chosen = _sampled(keystore)
    path = path_of(keystore.profile, target)
    steps = []
    with temporary_folder() as folder:
        for old, new in pairwise(generations(keystore, path, folder, now)):
            steps.append(_rehearsed(old, new, chosen, now))
    return Rehearsal(participants=len(names), sample=chosen, steps=tuple(steps))


def rehearse_addition(
    keystore: Keystore, profiles: Sequence[Profile], *, passphrase: bytes | None, now: datetime
) -> Rehearsal:
    """Add the sets of these profiles to a copy of the keystore; as `rehearse` otherwise.

    `passphrase` opens the CA keys of the copy, which sign what is added. A pair with old and new
    files must succeed, too, in the sets of before: nobody restarts for the addition.
    """
    names, chosen = _sampled(keystore)
    steps = []
    with temporary_folder() as folder:
        for old, new in pairwise(additions(keystore, profiles, folder, passphrase, now)):
            steps.append(_added(old, new, chosen, now))
    return Rehearsal(participants=len(names), sample=chosen, steps=tuple(steps))


def _sampled(keystore: Keystore) -> tuple[list[str], tuple[str, ...]]:
    """The participants with keys here, and the sample; KeystoreError if there are too few."""
    enclaves = keystore.folder / ENCLAVES
    names = [each for each in keystore.names() if exists(enclaves / each[1:] / KEY)]
    if len(names) < 2:  # noqa: PLR2004 -- a pair
        raise KeystoreError(
            "a rehearsal needs two participants whose keys are in the keystore",
            hint="rehearse with a keystore of two test participants: `pqsec demo`",
        )
    return names, tuple(names[:: -(-len(names) // SAMPLE)])


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
    pairs = _pairs(new.keystore, [each for each in names if each in reissued], now)
    same = {
        f"{each.one}, {each.other}": each.failure(new.keystore, new.keystore, now) for each in pairs
    }
    mixed = _mixed(pairs, old.keystore, new.keystore, now)
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


def _added(old: Addition, new: Addition, names: Sequence[str], now: datetime) -> RehearsedStep:
    """In the new set those who are in it authenticate each other, and in the others all, old and
    new."""
    view = new.keystore.sets[-1]
    pairs = _pairs(view, [each for each in names if each in new.issued], now)
    same = [(f"{each.one}, {each.other}", each.failure(view, view, now)) for each in pairs]
    every = _pairs(old.keystore, names, now)
    mixed = [
        (f"old and new files of set {before.profile.name}", each)
        for before, after in zip(old.keystore.sets, new.keystore.sets, strict=False)
        for each in _mixed(every, before, after, now)
    ]
    refused = [each for _, each in mixed if each]
    return RehearsedStep(
        profile=", ".join(each.name for each in new.keystore.profiles),
        reissued=len(new.issued),
        left_out=dict(new.left),
        succeeded=sum(each is None for _, each in same),
        failures=tuple(
            f"{pair}: {each.name}: {each.detail}" for pair, each in (*same, *mixed) if each
        ),
        old_with_new=len(mixed) - len(refused),
        old_with_new_refused=len(refused),
        reason=next((f"{each.name}: {each.detail}" for each in refused), ""),
    )


def _pairs(keystore: Keystore, names: Sequence[str], now: datetime) -> list[_Pair]:
    """The pairs of these participants that share a domain."""
    return [
        _Pair(one, other, domain)
        for one, other in combinations(names, 2)
        if (domain := _domain(keystore, one, other, now)) is not None
    ]


def _mixed(
    pairs: Sequence[_Pair], old: Keystore, new: Keystore, now: datetime
) -> list[CheckedStep | None]:
    """The failures of each pair with one party's files of before, and then with the other's."""
    return [
        each.failure(first, second, now)
        for each in pairs
        for first, second in ((old, new), (new, old))
    ]


def _domain(keystore: Keystore, one: str, other: str, now: datetime) -> int | None:
    setup = HandshakeSetup(keystore=keystore, domain=0, now=now)
    return min(JoinableDomains.of(setup, (one, other)).shared, default=None)
