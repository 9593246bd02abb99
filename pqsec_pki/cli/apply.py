"""pqsec apply: make the keystore as a domain file wants it."""

import sys
from collections import Counter
from pathlib import Path

import click

from pqsec_pki.cli import _common
from pqsec_pki.cli.plan import file_argument, keystore_or_none, prune_option, show, value
from pqsec_pki.domain import Action, Desired, Plan, make, perform, read_domain
from pqsec_pki.domain import plan as plan_steps
from pqsec_pki.errors import PqsecError, UsageError
from pqsec_pki.keystore import Authorities, Keystore


@click.command()
@file_argument
@click.option("--check", is_flag=True, help="Change nothing; exit code 1 if anything would be.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@prune_option
@click.option("--no-passphrase", is_flag=True, help="Leave the keys of new CAs unencrypted.")
@_common.passphrase_option
@_common.command_options
def apply(  # noqa: PLR0913 -- one for each option, by name
    file: Path,
    passphrase_file: Path | None,
    *,
    check: bool,
    yes: bool,
    prune: bool,
    no_passphrase: bool,
) -> None:
    """Make the keystore as FILE wants it: what `pqsec plan` tells is done.

    FILE is domain.yaml if it is not named. Each batch of participants is one change of
    the keystore. Killed at any time, run it again: it does what is left.
    """
    desired, keystore, now = read_domain(file), keystore_or_none(), _common.now()
    found = plan_steps(desired, keystore, now=now, prune=prune)
    if check or not found.steps:
        show(found, desired)
    else:
        _ask(found, desired, yes=yes)
        if keystore is None:
            keystore, authorities = _made(desired, passphrase_file, none=no_passphrase)
        else:
            authorities = _common.unlock(keystore, passphrase_file)
        _take(desired, keystore, authorities, found)
        _tell(found)
    if found.blocked or (check and found.steps):
        click.get_current_context().exit(1)


def _ask(found: Plan, desired: Desired, *, yes: bool) -> None:
    if yes:
        return
    if not sys.stdin.isatty():
        raise UsageError(
            f"there are {len(found.steps)} changes to make, and no terminal to ask",
            hint="`pqsec plan` shows them; --yes makes them",
        )
    show(found, desired)
    click.confirm("Do this?", abort=True, err=True)


def _made(
    desired: Desired, passphrase_file: Path | None, *, none: bool
) -> tuple[Keystore, Authorities]:
    path = _common.keystore_path()
    passphrase = _common.new_passphrase(passphrase_file, none=none)
    keystore = make(desired, path, passphrase=passphrase, now=_common.now())
    if none:
        _common.note(f"the CA keys in {path / 'private'} are not encrypted; guard that folder")
    return keystore, keystore.unlock(passphrase)


def _take(desired: Desired, keystore: Keystore, authorities: Authorities, found: Plan) -> None:
    """With a bar on a terminal that shows how far it is."""
    hidden, done = not sys.stderr.isatty(), 0
    try:
        with click.progressbar(length=len(found.steps), file=sys.stderr, hidden=hidden) as bar:
            for batch in perform(desired, keystore, authorities, found, now=_common.now()):
                bar.update(len(batch))
                done += len(batch)
    except PqsecError:
        _common.note(f"{done} of {len(found.steps)} changes are done; apply again does the rest")
        raise


def _tell(found: Plan) -> None:
    for each in found.blocked:
        _common.note(f"{each.name} {each.why}: that stays so")
    if any(step.action in {Action.REVOKE, Action.LIST} for step in found.steps):
        _common.note("there is a new revocation list: give it to every robot")
    counts: Counter[Action] = Counter()
    for step in found.steps:
        counts[step.action] += bool(step.name)
    lines = [f"{action.words}: {count or 'done'}" for action, count in counts.items()]
    as_json = _common.settings().json
    _common.emit({**value(found), "done": True} if as_json else None, lines)
