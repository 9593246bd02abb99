"""pqsec apply: change the keystore to match a domain file."""

from contextlib import suppress
from dataclasses import field, replace
from pathlib import Path

import click

from pqsec_pki._dataclass import dataclass
from pqsec_pki._places import refuse_obeyed, trusted_files
from pqsec_pki._progress import stage
from pqsec_pki.cli import _help, _passphrases, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.cli._plan_file import command_of, plan_in, refuse_choices, run_command
from pqsec_pki.cli._policy import SIGNED
from pqsec_pki.cli._superseded import note_superseded
from pqsec_pki.cli.plan import (
    PROPOSAL_SUFFIX,
    chosen_ca,
    file_argument,
    new_keys_option,
    note_ended,
    note_left,
    note_roles,
    only_option,
    prune_option,
    show,
)
from pqsec_pki.domain import (
    ApprovedPlan,
    Desired,
    Plan,
    Step,
    StepAction,
    apply_plan,
    change_profile,
    create_keystore,
    read_domain,
    refuse_mass_revocation,
    refuse_unapproved,
)
from pqsec_pki.domain import plan as plan_steps
from pqsec_pki.enrolment import refresh
from pqsec_pki.errors import PqsecError, UsageError
from pqsec_pki.keystore import Authorities, Keystore, SigningCa, list_delivery

_ON_LIST = {StepAction.REVOKE, StepAction.RENEW_CRL, StepAction.RENEW}
"""Steps that issue a revocation list, or may."""


@_help.command(
    examples={
        "Make the changes of `pqsec plan`, without a question": ("pqsec apply domain.yaml --yes"),
        "Test whether the keystore matches the file": "pqsec apply domain.yaml --check",
        "Make those that need the keys of the identity CA only": (
            "pqsec apply domain.yaml --only identity --yes"
        ),
        "Make the changes of a plan that was approved": "pqsec apply plan.json --yes",
        "Also write bundles for robots that generated their own keys": (
            "pqsec apply domain.yaml --yes --bundles bundles"
        ),
    },
    exit_codes={
        0: "the keystore matches the file, except for participants that were revoked",
        1: (
            "FILE is not valid, a participant stays blocked, or with --check there are changes to"
            " make; or a plan does not fit, or has too few approvals"
        ),
        3: "FILE or the keystore cannot be read, or a participant could not be changed",
    },
)
@file_argument
@click.option(
    "--check", is_flag=True, help="Change nothing; exit with 1 if there are changes to make."
)
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@prune_option
@new_keys_option
@only_option
@click.option(
    "--bundles",
    "folder",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Write to DIR a bundle for each participant that has its key on the robot.",
)
@click.option(
    "--approval",
    "approval_files",
    multiple=True,
    type=_settings.FILE,
    metavar="FILE",
    help="An approval of the plan FILE.  [default: those beside it: FILE.NAME.approval]",
)
@click.option(
    "--revoke-most",
    is_flag=True,
    help="With --yes: allow to revoke more participants than FILE names.",
)
@_passphrases.weak_option
@click.option("--no-passphrase", is_flag=True, help="Leave the keys of new CAs unencrypted.")
@_passphrases.option
@_settings.command_options
def apply(  # noqa: PLR0913 -- one for each option, by name
    file: Path,
    passphrase_file: Path | None,
    folder: Path | None,
    approval_files: tuple[Path, ...],
    only: str | None,
    *,
    check: bool,
    yes: bool,
    prune: bool,
    new_keys: bool,
    revoke_most: bool,
    no_passphrase: bool,
) -> None:
    """Change the keystore to match a domain file.

    FILE is domain.yaml if not named; `pqsec plan` shows the changes. Each batch of
    participants is one change of the keystore. If it is interrupted, run it again: it makes
    the changes that are left. A FILE that ends in .json is a plan of `pqsec plan -o` with
    approvals of `pqsec approve`: exactly its changes are made. Of `pqsec propose`, it is one
    command, which is run.
    """
    if check and folder:
        raise UsageError(
            "--check and --bundles exclude each other", hint="--check does not write anything"
        )
    part = chosen_ca(only)
    if words := command_of(file, is_chosen=prune or new_keys or bool(part)):
        refuse_choices(check=check, bundles=bool(folder))
        run_command(words, file, approval_files, passphrase_file, yes=yes, none=no_passphrase)
        return
    wanted = _wanted(file, approval_files, part, check=check, prune=prune, new_keys=new_keys)
    desired, keystore, found = wanted.desired, wanted.keystore, wanted.found
    if folder and found.only is SigningCa.IDENTITY:
        raise UsageError(
            "--bundles are written where the permissions are signed, and not with --only identity"
        )
    changes, done = bool(found.steps) and not check, list[Step]()
    if changes:
        if not yes:
            _ask(found, desired)
        elif not revoke_most:
            refuse_mass_revocation(desired, found)
        keystore, found = wanted.begun()
        passphrases = _CaPassphrases(passphrase_file, none=no_passphrase)
        keystore, done = _made(desired, keystore, found, passphrases, folder)
    written = _BundleWriter(desired, keystore, found, folder).fill(len(done)) if keystore else []
    if keystore and (written or changes):
        _report(desired, found, done, keystore, written)
    else:
        show(found, desired)
    if found.blocked or (check and found.steps):
        click.get_current_context().exit(1)


@dataclass(frozen=True, slots=True)
class _Wanted:
    """The changes to make."""

    desired: Desired
    keystore: Keystore | None
    found: Plan
    approved: ApprovedPlan | None = None

    def begun(self) -> tuple[Keystore | None, Plan]:
        """The keystore to change and the plan, after approvals are in the ledger."""
        if self.approved is None:
            return self.keystore, self.found
        begun = self.approved.begin(_settings.now())
        return begun.keystore, begun.plan


def _wanted(  # noqa: PLR0913 -- the options of the command
    file: Path,
    approval_files: tuple[Path, ...],
    part: SigningCa | None,
    *,
    check: bool,
    prune: bool,
    new_keys: bool,
) -> _Wanted:
    """The changes that the domain file or the plan in `file` needs."""
    if file.suffix == PROPOSAL_SUFFIX:
        desired, keystore, approved = plan_in(file, approval_files, to_change=not check)
        return _Wanted(desired, keystore, approved.plan, approved)
    if approval_files:
        raise UsageError("--approval is for a plan", hint="`pqsec plan` with -o makes one")
    return _of_domain(file, part, check=check, prune=prune, new_keys=new_keys)


def _of_domain(
    file: Path, part: SigningCa | None, *, check: bool, prune: bool, new_keys: bool
) -> _Wanted:
    desired, now = _read(file, check=check), _settings.now()
    keystore = Keystore.find(_settings.keystore_path(), to_change=not check)
    found = plan_steps(desired, keystore, now=now, prune=prune, new_keys=new_keys, only=part)
    if keystore and not check:
        refuse_unapproved(desired, keystore, found, now=now)
    return _Wanted(desired, keystore, found)


def _read(file: Path, *, check: bool) -> Desired:
    """The domain file; FileError if another user could change what the CAs will sign."""
    if check:
        return read_domain(file)
    with trusted_files(SIGNED):
        desired = read_domain(file)
    refuse_obeyed(desired.request_files, SIGNED)
    return desired


def _made(
    desired: Desired,
    keystore: Keystore | None,
    found: Plan,
    passphrases: "_CaPassphrases",
    folder: Path | None,
) -> tuple[Keystore, list[Step]]:
    """Make the changes: the keystore, created if it does not exist, and the steps made."""
    if keystore and found.changes_profile:
        passphrase, now = passphrases.new(), _settings.now()
        changed = change_profile(
            desired,
            keystore,
            found,
            passphrase=passphrase,
            compares_clock=_passphrases.compares_clock(),
            now=now,
        )
        return changed, [*found.steps]
    cas = (found.only,) if found.only else ()
    unlocked = passphrases.opened(desired, keystore, *cas)
    bundles = _BundleWriter(desired, unlocked.keystore, found, folder)
    done = _apply_steps(desired, unlocked, found, bundles)
    return _as_it_is(unlocked.keystore), done


def _as_it_is(keystore: Keystore) -> Keystore:
    """The keystore with all sets of credentials, also those that were added since."""
    now = Keystore.open(keystore.root, to_change=keystore.to_change)
    return replace(keystore, profiles=now.profiles)


def _ask(found: Plan, desired: Desired) -> None:
    confirm(
        lambda: show(found, desired),
        "Make these changes?",
        what=f"there are {len(found.steps)} changes to make",
        hint="`pqsec plan` shows them; --yes makes them",
    )


@dataclass(frozen=True, slots=True)
class _Unlocked:
    """A keystore, and its CAs with the passphrase that their keys have."""

    keystore: Keystore
    authorities: Authorities
    passphrase: bytes | None = field(repr=False)


@dataclass(frozen=True, slots=True)
class _CaPassphrases:
    """The passphrases of CA keys, old and new."""

    file: Path | None
    none: bool

    def new(self) -> bytes | None:
        """The passphrase for new CAs; None if their keys stay unencrypted."""
        return _passphrases.new(self.file, none=self.none)

    def opened(self, desired: Desired, keystore: Keystore | None, *cas: SigningCa) -> _Unlocked:
        """The keystore, created if it does not exist, and its CAs, or those of `cas`."""
        if keystore:
            passphrase = _passphrases.of_cas(keystore, self.file, *cas)
            cas_of_it = _passphrases.unlocked(keystore, passphrase, *cas)
            return _Unlocked(keystore, cas_of_it, passphrase)
        path, passphrase = _settings.keystore_path(), self.new()
        keystore = create_keystore(desired, path, passphrase=passphrase, now=_settings.now())
        if self.none:
            _passphrases.note_unencrypted(path)
        return _Unlocked(keystore, keystore.unlock(passphrase), passphrase)


@dataclass(frozen=True, slots=True)
class _BundleWriter:
    """Writes bundles into a folder, if there is one."""

    desired: Desired
    keystore: Keystore
    found: Plan
    folder: Path | None

    def fill(self, done: int) -> list[Path]:
        """Write bundles for all participants with keys on robots; returns the paths."""
        if self.folder is None:
            return []
        left = {each.name for each in self.found.blocked}
        left |= {each.name for each in self.found.ended}
        wanted = self.desired.members.keys() - left
        keystore = _as_it_is(self.keystore)
        has, has_key = keystore.has, keystore.has_key
        elsewhere = sorted(name for name in wanted if has(name) and not has_key(name))
        try:
            return list(refresh(keystore, elsewhere, self.folder, now=_settings.now()))
        except PqsecError:
            if done:
                _printing.note(f"all {done} changes are made; run apply again to write the bundles")
            raise


def _apply_steps(
    desired: Desired,
    unlocked: _Unlocked,
    found: Plan,
    bundles: _BundleWriter,
) -> list[Step]:
    """Make the changes. Returns the steps that were made."""
    done, every = list[Step](), len(found.steps)
    batches = apply_plan(
        desired,
        unlocked.keystore,
        unlocked.authorities,
        found,
        passphrase=unlocked.passphrase,
        now=_settings.now(),
    )
    try:
        with stage(every, "changes") as here:
            for batch in batches:
                done += batch
                here.reach(len(done))
    except PqsecError:
        _printing.note(f"{len(done)} of {every} changes are made; run apply again to make the rest")
        with suppress(PqsecError):  # the first error is reported
            bundles.fill(0)
        raise
    if len(done) < every:
        _printing.note(f"{every - len(done)} changes were made by another command in the meantime")
    return done


def _report(
    desired: Desired, found: Plan, done: list[Step], keystore: Keystore, written: list[Path]
) -> None:
    if found.changes_profile:
        _printing.note(
            "copy to every robot its enclave folder, with the files that its links point to, and"
            " restart all participants of a domain together; run apply again for other changes"
        )
    _note_blocked(found)
    note_ended(found)
    note_roles(desired)
    note_left(found)
    now, replacing = _settings.now(), {StepAction.ISSUE, StepAction.REPLACE, StepAction.RENEW}
    on_list = any(step.action in _ON_LIST for step in done)
    with keystore.hold():  # so that the ledger is read once
        note_superseded(keystore, [each.name for each in done if each.action in replacing], now)
        delivery = list_delivery(keystore, now=now) if on_list else None
    changed = {step.participant for step in done if step.action is not StepAction.REVOKE} - {""}
    waiting = [name for name in sorted(changed) if not keystore.has_key(name)]
    if waiting and not written:
        fix = "write their bundles with --bundles DIR or `pqsec bundle`"
        _printing.note(f"the keys of these are on their robots: {_printing.few(waiting)}; {fix}")
    names: dict[StepAction, list[str]] = {}
    for step in done:
        names.setdefault(step.action, []).extend(filter(None, [step.name]))
    lines = [
        f"{action.words}: {len(each)} ({_printing.few(each)})" if each else f"{action.words}: done"
        for action, each in names.items()
    ]
    lines += [f"bundles: {len(written)}"] if written else []
    lines += delivery.lines if delivery and delivery.late else ()
    value = replace(found, steps=tuple(done)).to_json()
    value |= {"done": True, "bundles": written}
    _printing.emit(value | ({"delivery": delivery} if delivery else {}), lines)


def _note_blocked(found: Plan) -> None:
    """One note for each reason, whatever number of participants it keeps unchanged."""
    names: dict[str, list[str]] = {}
    for each in found.blocked:
        names.setdefault(each.why, []).append(each.name)
    for why, those in names.items():
        who = those[0] if len(those) == 1 else f"each of {_printing.few(those)}"
        _printing.note(f"{who} {why}: not changed")
