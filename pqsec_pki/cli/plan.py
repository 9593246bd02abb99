"""pqsec plan: show the changes that `pqsec apply` would make."""

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.domain import Desired, Plan, StepAction, new_domain, read_domain
from pqsec_pki.domain import plan as plan_steps
from pqsec_pki.keystore import Keystore

DEFAULT_FILE = Path("domain.yaml")

file_argument = click.argument("file", type=_settings.FILE, default=DEFAULT_FILE, metavar="[FILE]")
prune_option = click.option(
    "--prune", is_flag=True, help="Also revoke participants that FILE does not name."
)
new_keys_option = click.option(
    "--new-keys",
    is_flag=True,
    help="Also certify new keys of existing participants.",
)


@_help.command(
    examples={
        "Write a new file to edit": "pqsec plan --init fleet.yaml",
        "Show the changes": "pqsec plan domain.yaml",
    },
    exit_codes={
        0: "the keystore matches the file",
        1: "there are changes to make, or FILE is not valid",
        3: "FILE or the keystore cannot be read",
    },
)
@file_argument
@click.option("--init", is_flag=True, help="Write a new, commented FILE to edit.")
@prune_option
@new_keys_option
@_settings.command_options
def plan(file: Path, *, init: bool, prune: bool, new_keys: bool) -> None:
    """Show the changes that `pqsec apply` would make.

    FILE describes a whole domain: its governance, participants and their rights. It is
    domain.yaml if not named.
    """
    if init:
        _files.write(file, new_domain("Robots"))
        _printing.emit({"written": file}, [f"{file}: edit it, then run `pqsec plan`"])
        return
    desired = read_domain(file)
    keystore, now = Keystore.find(_settings.keystore_path()), _settings.now()
    found = plan_steps(desired, keystore, now=now, prune=prune, new_keys=new_keys)
    show(found, desired)
    if not found.in_order:
        click.get_current_context().exit(1)


def show(found: Plan, desired: Desired) -> None:
    """Print the plan, and notes on what it does not change."""
    _printing.emit(found.to_json(), lines(found))
    if desired.ungoverned:
        where = ", ".join(map(str, desired.ungoverned))
        _printing.note(f"the governance does not name domain {where}: no participant can join it")
    if found.unlisted:
        names = _printing.few(found.unlisted)
        _printing.note(f"not in {desired.path}: {names}; --prune revokes them")


def lines(found: Plan) -> Iterator[str]:
    """The plan as lines, one for each group of similar steps."""
    width = max((len(step.action.words) for step in found.steps), default=0)
    alike = groupby(found.steps, key=lambda step: (step.action, _kind(step.action, step.why)))
    for (action, why), steps in alike:
        names = [step.name for step in steps]
        yield f"{action.words:<{width}}  {_printing.few(names)}{'  ' * any(names)}({why})"
    for each in found.blocked:
        yield f"blocked: {each.name} {each.why}; {each.way_out}"
    count = len(found.steps)
    right = found.unchanged
    rest = f"{right} {'participant is' if right == 1 else 'participants are'} up to date"
    yield f"{count or 'no'} {'change' if count == 1 else 'changes'}; {rest}"


def _kind(action: StepAction, why: str) -> str:
    """The reason that similar steps share; for a renewal, without its date."""
    return why.split(maxsplit=1)[0] if action is StepAction.RENEW else why
