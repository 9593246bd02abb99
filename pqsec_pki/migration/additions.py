"""Migration by addition: sets of credentials of further profiles, beside those that run."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Profile
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import CA_VALIDITY, Addable, add_set, addable
from pqsec_pki.migration._temporary_folder import temporary_folder
from pqsec_pki.migration.generations import SAMPLES, copied, sample
from pqsec_pki.migration.meetings import Side, failure
from pqsec_pki.migration.planning import plugin_needs
from pqsec_pki.migration.steps import MigrationPlan, MigrationStep, StackNeeds
from pqsec_pki.selfcheck import PQSEC, CheckedStep, SimulatedStack

_MOST = 5
"""Names in a fact."""
_BACK = (
    "robots keep all their files, so nothing is to be done there",
    "restore the backup of the keystore from before, if nothing was issued or revoked since",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Addition:
    """A copy of a keystore after the addition of a set."""

    keystore: Keystore
    issued: tuple[str, ...]
    left: tuple[tuple[str, str], ...]
    """Who has no credentials of the new set, and why."""


def added_to(keystore: Keystore, profiles: Sequence[Profile]) -> tuple[Profile, ...]:
    """Those of `profiles` of which the keystore has no set, in order.

    KeystoreError unless they begin with those of the keystore: nothing is removed or moved.
    """
    there = [each.name for each in keystore.profiles]
    if [each.name for each in profiles[: len(there)]] != there:
        raise KeystoreError(
            f"{keystore.root} has profile {', '.join(there)}, and a set is added behind those that"
            " are there: none is removed",
            hint=f"give them first: `--to {','.join((*there, 'PROFILE'))}`",
        )
    names = [each.name for each in profiles]
    if twice := next((each for each in names if names.count(each) > 1), None):
        raise UsageError(f"profile {twice} is given twice")
    return tuple(profiles[len(there) :])


def additions(
    first: Keystore,
    profiles: Sequence[Profile],
    folder: Path,
    passphrase: bytes | None,
    now: datetime,
) -> Iterator[Addition]:
    """`first`, then a copy for each set that is added, each in its own part of `folder`.

    `first` is not changed. Errors as of `added_to`, `Keystore.unlock` and `add_set`.
    """
    current = Addition(keystore=first, issued=(), left=())
    yield current
    for number, profile in enumerate(added_to(first, profiles), 1):
        root = folder / f"addition{number}"
        copied(current.keystore.root, root)
        # a copy is not trusted, so it needs no approvals
        keystore = replace(Keystore.open(root, to_change=True), approved=True)
        left = addable(keystore, now=now).left
        added = add_set(
            keystore,
            keystore.unlock(passphrase),
            profile,
            validity=CA_VALIDITY,
            passphrase=passphrase,
            now=now,
        )
        current = Addition(
            keystore=added.keystore.sets[0],
            issued=tuple(each.name for each in added.issued),
            left=tuple(left.items()),
        )
        yield current


def plan_addition(
    keystore: Keystore,
    profiles: Sequence[Profile],
    stacks: tuple[SimulatedStack, ...],
    *,
    now: datetime,
) -> MigrationPlan:
    """The steps that add sets of credentials of these profiles, for robots with these stacks.

    `profiles` begin with those of the keystore. Whether robots with old and new files meet is
    found by handshakes of sample participants in a temporary folder. Errors as of `added_to`.
    """
    new, steps = added_to(keystore, profiles), list[MigrationStep]()
    found = addable(keystore, now=now) if new else None
    if found:
        with temporary_folder() as folder:
            before = sample(folder / "sample", keystore.profile, now)
            (folder / "copies").mkdir()
            sets = (keystore.profile, *new)
            made = [*additions(before, sets, folder / "copies", None, now)]
            finder = _Finder(keystore, found, stacks, made[0].keystore, made[-1].keystore, now)
            there = [each.name for each in keystore.profiles]
            for profile in new:
                steps.append(finder.addition(there, profile))
                there.append(profile.name)
            steps.append(finder.plugin(there, new[-1]))
    return MigrationPlan(
        before=_said([each.name for each in keystore.profiles]),
        target=_said([each.name for each in profiles]),
        steps=tuple(steps),
    )


@dataclass(frozen=True, slots=True)
class _Finder:
    keystore: Keystore
    found: Addable
    stacks: tuple[SimulatedStack, ...]
    before: Keystore
    """Of the sample participants, as `after`, which has all sets."""
    after: Keystore
    now: datetime

    def addition(self, there: Sequence[str], profile: Profile) -> MigrationStep:
        """The step that adds the set of this profile beside those that are there."""
        new, sets = profile.name, _said(there)
        words = f"certificates of set {new} for {_some(self.found.issued)}"
        refused = {
            name or "the keystore": f"{error}; {error.hint or 'restore that file'}"
            for name, error in self.found.refused.items()
        }
        failed = self._fails(self.before, self.after, PQSEC)
        return MigrationStep(
            title=f"add a set of credentials of profile {new} beside {sets}",
            before=sets,
            after=_said([*there, new]),
            commands=(f"pqsec ca add-set {new}",),
            added=(f"CAs, governance and lists of set {new}, in sets/{new}", words),
            removed=(f"nothing: no file of {sets} changes, and no robot restarts",),
            back=_BACK,
            at_once=failed is not None,
            stacks=tuple(self._needs(each) for each in self.stacks),
            mixed=f"robots with old and with new files {_meet(failed)}",
            if_skipped=(f"no participant has keys of profile {new}",),
            left_out={**self.found.left, **refused},
            level=0 if self.keystore.profile.runs_in_stock else self.keystore.profile.level,
        )

    def plugin(self, there: Sequence[str], strongest: Profile) -> MigrationStep:
        """The step by which robots use what was added; those with stock stacks go on as before."""
        stock = self.keystore.stock
        sets = _said(there)
        names = (
            f"those that `stock` names ({_some(stock)})" if stock else "nobody: `stock` is empty"
        )
        return MigrationStep(
            title=f"install pqsec's plugin on robots, which then use set {strongest.name}",
            before=sets,
            after=sets,
            commands=(
                "pqsec plugin install",
                "stock: [names or patterns] in domain.yaml, of robots that stay without the plugin",
            ),
            added=(f"set {strongest.name} on each of these robots, at its next start",),
            removed=(f"nothing: each keeps set {there[0]}, which stock stacks see",),
            back=("`pqsec plugin uninstall` on a robot, and its name in `stock` of all others",),
            at_once=False,
            stacks=tuple(map(plugin_needs, self.stacks)),
            mixed=f"robots with the plugin meet with set {there[0]} only {names}",
            if_skipped=(f"traffic keeps NIST level 0 instead of {strongest.level}",),
            left_out={},
            level=0 if stock else strongest.level,
        )

    def _needs(self, stack: SimulatedStack) -> StackNeeds:
        failed = self._fails(self.before, self.after, stack)
        return StackNeeds(stack=stack.title, needs=_words(failed) if failed else "nothing")

    def _fails(self, old: Keystore, new: Keystore, stack: SimulatedStack) -> CheckedStep | None:
        """The first failure of old with new files of the first set, whichever initiates."""
        one, other = SAMPLES
        for first, second in ((old, new), (new, old)):
            sides = Side(first, one, stack), Side(second, other, stack)
            if found := failure(*sides, 0, self.now):
                return found
        return None


def _meet(failed: CheckedStep | None) -> str:
    return f"refuse each other: {_words(failed)}" if failed else "accept each other"


def _words(step: CheckedStep) -> str:
    return f"{step.name}: {step.detail}"


def _said(names: Sequence[str]) -> str:
    return ", ".join(names)


def _some(names: Sequence[str]) -> str:
    """The names, or how many if there are more than a few."""
    return ", ".join(names) or "nobody" if len(names) <= _MOST else f"{len(names)} participants"
