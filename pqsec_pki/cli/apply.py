"""pqsec apply: make the keystore as a domain file wants it."""

import sys
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import click

from pqsec_pki.cli import _passphrases, _printing, _settings
from pqsec_pki.cli.plan import (
    few,
    file_argument,
    keystore_or_none,
    new_keys_option,
    prune_option,
    show,
    value,
)
from pqsec_pki.domain import Action, Desired, Plan, Step, apply_plan, create_keystore, read_domain
from pqsec_pki.domain import plan as plan_steps
from pqsec_pki.enrolment import refresh
from pqsec_pki.errors import PqsecError, UsageError
from pqsec_pki.keystore import Authorities, Keystore


@click.command()
@file_argument
@click.option("--check", is_flag=True, help="Change nothing; exit code 1 if anything would be.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@prune_option
@new_keys_option
@click.option(
    "--bundles",
    "folder",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Keep in DIR the bundle of each participant whose key is on its robot.",
)
@click.option(
    "--revoke-most", is_flag=True, help="Let --yes revoke more participants than FILE names."
)
@click.option("--no-passphrase", is_flag=True, help="Leave the keys of new CAs unencrypted.")
@_passphrases.option
@_settings.command_options
def apply(  # noqa: PLR0913 -- one for each option, by name
    file: Path,
    passphrase_file: Path | None,
    folder: Path | None,
    *,
    check: bool,
    yes: bool,
    prune: bool,
    new_keys: bool,
    revoke_most: bool,
    no_passphrase: bool,
) -> None:
    """Make the keystore as FILE wants it: what `pqsec plan` tells is done.

    FILE is domain.yaml if it is not named. Each batch of participants is one change of
    the keystore. Killed at any time, run it again: it does what is left.
    """
    if check and folder:
        raise UsageError("--check changes nothing, and --bundles writes", hint="leave one out")
    desired, now = read_domain(file), _settings.now()
    keystore = keystore_or_none(to_change=not check)
    found = plan_steps(desired, keystore, now=now, prune=prune, new_keys=new_keys)
    done = list[Step]()
    if found.steps and not check:
        if yes:
            _refuse_slips(found, desired, revoke_most=revoke_most)
        else:
            _ask(found, desired)
        keystore, authorities = _opened(desired, keystore, passphrase_file, none=no_passphrase)
        outbox = _Outbox(desired, keystore, found, folder)
        done = _take(desired, keystore, authorities, found, outbox)
    written = _Outbox(desired, keystore, found, folder).fill(len(done)) if keystore else []
    if keystore and (written or (found.steps and not check)):
        _tell(found, done, keystore, written)
    else:
        show(found, desired)
    if found.blocked or (check and found.steps):
        click.get_current_context().exit(1)


def _refuse_slips(found: Plan, desired: Desired, *, revoke_most: bool) -> None:
    """A list that was cut short would take back a fleet, and nothing brings that back."""
    if found.revoked > len(desired.members) and not revoke_most:
        raise UsageError(
            f"{found.revoked} participants would be revoked, and {desired.path} names"
            f" {len(desired.members)}",
            hint="is a list it names cut short? if it is meant: --revoke-most",
        )


def _ask(found: Plan, desired: Desired) -> None:
    if _settings.settings().json:
        raise UsageError("--json asks nobody", hint="`pqsec plan --json` shows it; --yes does it")
    if not sys.stdin.isatty():
        raise UsageError(
            f"there are {len(found.steps)} changes to make, and no terminal to ask",
            hint="`pqsec plan` shows them; --yes makes them",
        )
    show(found, desired)
    click.confirm("Do this?", abort=True, err=True)


def _opened(
    desired: Desired, keystore: Keystore | None, passphrase_file: Path | None, *, none: bool
) -> tuple[Keystore, Authorities]:
    """The keystore, made if there is none, and its CAs."""
    if keystore:
        return keystore, _passphrases.unlock(keystore, passphrase_file)
    path = _settings.keystore_path()
    passphrase = _passphrases.new(passphrase_file, none=none)
    keystore = create_keystore(desired, path, passphrase=passphrase, now=_settings.now())
    if none:
        _printing.note(f"the CA keys in {path / 'private'} are not encrypted; guard that folder")
    return keystore, keystore.unlock(passphrase)


@dataclass(frozen=True, slots=True)
class _Outbox:
    """Where bundles are kept, if that is wanted."""

    desired: Desired
    keystore: Keystore
    found: Plan
    folder: Path | None

    def fill(self, done: int) -> list[Path]:
        """Those written, for all whose keys are on their robots: not only for who was changed."""
        if self.folder is None:
            return []
        wanted = self.desired.members.keys() - {each.name for each in self.found.blocked}
        has, has_key = self.keystore.has, self.keystore.has_key
        elsewhere = sorted(name for name in wanted if has(name) and not has_key(name))
        try:
            return list(refresh(self.keystore, elsewhere, self.folder, now=_settings.now()))
        except PqsecError:
            if done:
                _printing.note(f"all {done} changes are done; apply again writes the bundles")
            raise


def _take(
    desired: Desired, keystore: Keystore, authorities: Authorities, found: Plan, outbox: _Outbox
) -> list[Step]:
    """With a bar on a terminal that shows how far it is."""
    hidden, done = not sys.stderr.isatty(), list[Step]()
    every = len(found.steps)
    try:
        with click.progressbar(length=every, file=sys.stderr, hidden=hidden) as bar:
            for batch in apply_plan(desired, keystore, authorities, found, now=_settings.now()):
                bar.update(len(batch))
                done += batch
    except PqsecError:
        _printing.note(f"{len(done)} of {every} changes are done; apply again does the rest")
        with suppress(PqsecError):  # what kept the others from being done is told
            outbox.fill(0)
        raise
    if len(done) < every:
        _printing.note(f"{every - len(done)} changes were made meanwhile by another command")
    return done


def _tell(found: Plan, done: list[Step], keystore: Keystore, written: list[Path]) -> None:
    for each in found.blocked:
        _printing.note(f"{each.name} {each.why}: that stays so")
    if any(step.action in {Action.REVOKE, Action.RENEW_CRL} for step in done):
        _printing.note("there is a new revocation list: give it to every robot")
    changed = {step.name for step in done if step.name and step.action is not Action.REVOKE}
    waiting = [name for name in sorted(changed) if not keystore.has_key(name)]
    if waiting and not written:
        way = "--bundles DIR, or `pqsec bundle`, makes what they need"
        _printing.note(f"their keys are on their robots: {few(waiting)}; {way}")
    counts: Counter[Action] = Counter()
    for step in done:
        counts[step.action] += bool(step.name)
    lines = [f"{action.words}: {count or 'done'}" for action, count in counts.items()]
    lines += [f"bundles: {len(written)}"] if written else []
    made = {"done": True, "bundles": list(map(str, written))}
    as_json = _settings.settings().json
    _printing.emit({**value(replace(found, steps=tuple(done))), **made} if as_json else None, lines)
