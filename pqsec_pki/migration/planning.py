"""Plans a migration from what sample participants can do in each profile and stack."""

from datetime import datetime
from itertools import pairwise

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Family, Profile, profile_named, protection_lost
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import Rollover, RolloverPlan, plan_rollover
from pqsec_pki.migration._temporary_folder import temporary_folder
from pqsec_pki.migration.generations import SAMPLES, Generation, generations, sample
from pqsec_pki.migration.meetings import Side, failure
from pqsec_pki.migration.steps import MigrationPlan, MigrationStep, StackNeeds
from pqsec_pki.selfcheck import PQSEC, CheckedStep, SimulatedStack
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import exporter_of

_TRANSITION, _CLASSICAL = "transition", "classical"
_STOCK_PEERS = 'pqsec.toml beside the certificate: peers = "stock"'


def path_of(before: Profile, target: Profile) -> tuple[Profile, ...]:
    """The profiles to change to, in order: through `transition`, if the keystore is classical."""
    if before.name == target.name:
        return ()
    if before.name == _CLASSICAL and target.name != _TRANSITION:
        return (profile_named(_TRANSITION), target)
    return (target,)


def plan_migration(
    keystore: Keystore, target: Profile, stacks: tuple[SimulatedStack, ...], *, now: datetime
) -> MigrationPlan:
    """The steps from the keystore's profile to `target` for robots with these stacks.

    It takes sample participants through all profiles in a temporary folder. Errors of
    `plan_rollover` if the keystore cannot be rolled over; KeystoreError if it has several sets.
    """
    refuse_several(keystore)
    path = path_of(keystore.profile, target)
    steps: list[MigrationStep] = []
    with temporary_folder() as folder:
        first = sample(folder / "generation0", keystore.profile, now)
        made = tuple(generations(first, path, folder, now))
        finder = _StepFinder(stacks, now, has_plugin=keystore.profile.runs_in_stock is False)
        for old, new in pairwise(made):
            rollover = plan_rollover(keystore, Rollover(profile=new.profile), now=now)
            steps += finder.steps(old, new, rollover)
    return MigrationPlan(before=keystore.profile.name, target=target.name, steps=tuple(steps))


def refuse_several(keystore: Keystore) -> None:
    """KeystoreError for several sets of credentials: no step replaces one of them."""
    names = [each.name for each in keystore.profiles]
    if len(names) > 1:
        raise KeystoreError(
            f"{keystore.root} has sets of credentials of profiles {', '.join(names)}, and a"
            " migration to one profile is for one set",
            hint=f"`--to {','.join(names)},PROFILE` plans to add a set of another profile",
        )


@dataclass(slots=True)
class _StepFinder:
    stacks: tuple[SimulatedStack, ...]
    now: datetime
    has_plugin: bool
    """Whether the robots run pqsec's plugin already."""
    accepts_stock: bool = False
    """Whether the plugin accepts peers without it, until the next rollover."""

    def steps(
        self, old: Generation, new: Generation, rollover: RolloverPlan
    ) -> list[MigrationStep]:
        """The steps from one generation to the next: the plugin if it is needed, then the CAs."""
        refusals = {
            each.name: found for each in self.stacks if (found := self._fails(new, each, each))
        }
        steps = []
        if refusals and not self.has_plugin and not new.profile.runs_in_stock:
            steps = [self._plugin(old, new, refusals)]
            self.has_plugin = True
            self.accepts_stock = old.profile.alternative_key is not None
        return [*steps, self._rotation(old, new, rollover, refusals)]

    def _plugin(
        self, old: Generation, new: Generation, refusals: dict[str, CheckedStep]
    ) -> MigrationStep:
        mixed = [self._mixed(old, each) for each in self.stacks]
        peers = (_STOCK_PEERS,) if old.profile.alternative_key else ()
        return MigrationStep(
            title="install pqsec's plugin on every robot",
            before=old.profile.name,
            after=old.profile.name,
            commands=("pqsec plugin install", *peers),
            at_once=False,
            stacks=tuple(map(plugin_needs, self.stacks)),
            mixed="; ".join(mixed),
            if_skipped=tuple(
                f"profile {new.profile.name}: {each.title} stops at {_words(refusals[each.name])}"
                for each in self.stacks
                if each.name in refusals
            ),
            left_out={},
            level=0 if peers else old.profile.level,
        )

    def _rotation(
        self,
        old: Generation,
        new: Generation,
        rollover: RolloverPlan,
        refusals: dict[str, CheckedStep],
    ) -> MigrationStep:
        failed = failure(
            Side(old.keystore, SAMPLES[0], PQSEC),
            Side(new.keystore, SAMPLES[1], PQSEC),
            0,
            self.now,
        )
        words = f"refuse each other: {_words(failed)}" if failed else "accept each other"
        before = 0 if self.accepts_stock or not self.has_plugin else old.profile.level
        after = new.profile.level if self.has_plugin else 0
        strict = (f"remove {_STOCK_PEERS}",) if self.accepts_stock else ()
        self.accepts_stock = False
        return MigrationStep(
            title=f"change the keystore from profile {old.profile.name} to {new.profile.name}",
            before=old.profile.name,
            after=new.profile.name,
            commands=(f"pqsec ca rotate --profile {new.profile.name} --apply", *strict),
            at_once=failed is not None,
            stacks=tuple(self._needs(each, refusals.get(each.name)) for each in self.stacks),
            mixed=f"robots with old and with new files {words}",
            lost=protection_lost(old.profile, new.profile),
            if_skipped=_kept(old.profile, new.profile, before, after),
            reissued=len(rollover.keeping) + len(rollover.rekeyed),
            left_out=dict(rollover.left_out),
            level=after,
        )

    def _needs(self, stack: SimulatedStack, refusal: CheckedStep | None) -> StackNeeds:
        if refusal is None:
            needs = "pqsec's plugin, as before" if self.has_plugin else "nothing"
        elif self.has_plugin:
            needs = "pqsec's plugin"
        else:
            needs = f"{refusal.hint or 'another stack'} ({_words(refusal)})"
        return StackNeeds(stack=stack.title, needs=needs)

    def _mixed(self, old: Generation, stack: SimulatedStack) -> str:
        failed = self._fails(old, stack, PQSEC)
        words = f"refuse each other at {_words(failed)}" if failed else "accept each other"
        return f"{stack.title} with and without the plugin {words}"

    def _fails(
        self, generation: Generation, one: SimulatedStack, other: SimulatedStack
    ) -> CheckedStep | None:
        """The first failure of the two stacks, whichever initiates."""
        first, second = SAMPLES
        for name, peer in ((first, second), (second, first)):
            sides = (
                Side(generation.keystore, name, one),
                Side(generation.keystore, peer, other),
            )
            if found := failure(*sides, 0, self.now):
                return found
        return None


def plugin_needs(stack: SimulatedStack) -> StackNeeds:
    """What the plugin needs of this stack."""
    exporter = exporter_of(_stack_of(stack))
    files = ", ".join(exporter.loads_ours)
    needs = f"{files}; version {exporter.versions}" if files else "another stack: no plugin"
    return StackNeeds(stack=stack.title, needs=needs)


def _kept(old: Profile, new: Profile, before: int, after: int) -> tuple[str, ...]:
    """What stays as it is without the change."""
    rows = {*old.signature_keys, *([old.alternative_key] if old.alternative_key else [])}
    weak = sorted(row.name for row in rows if row.family is Family.CLASSICAL)
    stronger = weak and new.signature_level
    found = [f"certificates and documents keep {', '.join(weak)} keys"] if stronger else []
    if before < after:
        found.append(f"traffic keeps NIST level {before} instead of {after}")
    lost = [f"not met: {each.text}" for each in new.promises if not each.kept(old)]
    return (*found, *lost)


def _stack_of(row: SimulatedStack) -> Stack:
    return next(each for each in Stack if row.name.startswith(each))


def _words(step: CheckedStep | None) -> str:
    return f"{step.name}: {step.detail}" if step else ""
