"""pqsec plan: show the changes that `pqsec apply` would make."""

from collections.abc import Iterator
from datetime import timedelta
from itertools import groupby
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.approvals import approve, proposal_file
from pqsec_pki.cli import _approver, _help, _printing, _settings
from pqsec_pki.cli._policy import note_ros_names
from pqsec_pki.domain import (
    Desired,
    Plan,
    PlanReview,
    StepAction,
    new_domain,
    propose,
    read_domain,
)
from pqsec_pki.domain import plan as plan_steps
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import Keystore, SigningCa

DEFAULT_FILE = Path("domain.yaml")
PROPOSAL_SUFFIX = ".json"
"""Distinguishes proposals from domain files."""

file_argument = click.argument("file", type=_settings.FILE, default=DEFAULT_FILE, metavar="[FILE]")
prune_option = click.option(
    "--prune", is_flag=True, help="Also revoke participants that FILE does not name."
)
new_keys_option = click.option(
    "--new-keys",
    is_flag=True,
    help="Also certify new keys of existing participants.",
)
only_option = click.option(
    "--only",
    type=click.Choice([each.label for each in SigningCa]),
    help="Select only changes that need the keys of this CA, if each CA has its own machine.",
)


def chosen_ca(only: str | None) -> SigningCa | None:
    """The CA that --only names."""
    return next((each for each in SigningCa if each.label == only), None)


@_help.command(
    examples={
        "Write a new file to edit": "pqsec plan --init fleet.yaml",
        "Show the changes": "pqsec plan domain.yaml",
        "Propose them to those who must approve": (
            "pqsec plan domain.yaml -o plan.json --key alice.pem"
        ),
    },
    exit_codes={
        0: "the keystore matches the file, except for participants that were revoked",
        1: "there are changes to make, or FILE is not valid, or the key is not an approver's",
        3: "FILE or the keystore cannot be read",
    },
)
@file_argument
@click.option("--init", is_flag=True, help="Write a new, commented FILE to edit.")
@prune_option
@new_keys_option
@only_option
@click.option(
    "-o",
    "--output",
    type=_settings.FILE,
    metavar="PLAN.json",
    help="Write the changes to this file, for `pqsec approve` and `pqsec apply`.",
)
@click.option(
    "--key",
    metavar="FILE|URI",
    help="With -o: sign it with this private key, which must be an approver's.",
)
@click.option(
    "--validity",
    type=_settings.Duration(),
    default="7d",
    show_default=True,
    help="With -o: it can be approved and applied this long.",
)
@click.option("--force", is_flag=True, help="With -o: replace the file.")
@_approver.passphrase_option
@_settings.command_options
def plan(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    file: Path,
    output: Path | None,
    key: str | None,
    validity: timedelta,
    key_passphrase_file: Path | None,
    only: str | None,
    *,
    init: bool,
    prune: bool,
    new_keys: bool,
    force: bool,
) -> None:
    """Show the changes that `pqsec apply` would make.

    FILE describes a whole domain: its governance, participants and their rights. It is
    domain.yaml if not named. Where changes need approvals, -o writes a proposal of exactly these
    changes, which counts as an approval by its maker.
    """
    _refuse_options(output, key, init=init, force=force)
    if init:
        _files.write(file, new_domain("Robots"))
        _printing.emit({"written": file}, [f"{file}: edit it, then run `pqsec plan`"])
        return
    desired = read_domain(file)
    keystore, now = Keystore.find(_settings.keystore_path()), _settings.now()
    part = chosen_ca(only)
    found = plan_steps(desired, keystore, now=now, prune=prune, new_keys=new_keys, only=part)
    review = PlanReview(desired, keystore, found, now) if keystore else None
    if output and key is not None:
        if review is None:
            raise KeystoreError("there is no keystore yet", hint="`pqsec apply` creates it")
        _refuse_nothing(found)
        signer = _approver.key_at(key, key_passphrase_file)
        _write(review, output, signer, validity, prune=prune, new_keys=new_keys, force=force)
    show(found, desired, written=output)
    if review:
        _note_approvals(review)
    if not found.in_order and not output:
        click.get_current_context().exit(1)


def _refuse_options(output: Path | None, key: str | None, *, init: bool, force: bool) -> None:
    if (output is None) is not (key is None) or (init and output):
        raise UsageError(
            "-o and --key need each other, and exclude --init",
            hint="-o plan.json --key KEY writes a proposal that this key signs",
        )
    if output:
        refuse_output(output, force=force)


def refuse_output(output: Path, *, force: bool) -> None:
    """UsageError for a file that `pqsec apply` would not take as a plan; ExistsError."""
    if output.suffix != PROPOSAL_SUFFIX:
        raise UsageError(
            f"{output} must end in {PROPOSAL_SUFFIX}",
            hint="`pqsec apply` knows a plan by it",
        )
    if not force:
        _files.refuse_existing(output)


def _refuse_nothing(found: Plan) -> None:
    if not found.steps:
        raise KeystoreError("there is nothing to change", hint="`pqsec plan` shows what is blocked")


def _write(
    review: PlanReview,
    output: Path,
    signer: PrivateKey,
    validity: timedelta,
    *,
    force: bool,
    **choices: bool,
) -> None:
    """Write the proposal with the approval of the holder of `signer`."""
    name = _approver.name_in(review.keystore.approvals, signer)
    folder = output.absolute().parent
    proposal = propose(review, proposer=name, validity=validity, beside=folder, **choices)
    first = approve(proposal.digest, name, signer, now=review.now)
    data = proposal_file(proposal, first)
    _files.write(output, data, force=force)


def _note_approvals(review: PlanReview) -> None:
    policy = review.keystore.approvals
    if words := policy.demand(review.kinds) if policy else "":
        _printing.note(words)


def show(found: Plan, desired: Desired, *, written: Path | None = None) -> None:
    """Print the plan, and notes on what it does not change."""
    place = {"written": written} if written else {}
    _printing.emit({**found.to_json(), **place}, lines(found))
    if desired.ungoverned:
        where = ", ".join(map(str, desired.ungoverned))
        _printing.note(f"the governance does not name domain {where}: no participant can join it")
    note_ended(found)
    note_roles(desired)
    note_left(found)
    if found.unlisted:
        names = _printing.few(found.unlisted)
        _printing.note(f"not in {desired.path}: {names}; --prune revokes them")


def note_roles(desired: Desired) -> None:
    """Note which topics of roles look like mistakes."""
    note_ros_names(grant for spec in desired.examples for grant in spec.grants)


def note_ended(found: Plan) -> None:
    """Tell which participants of the file were revoked: nothing is done for them."""
    if found.ended:
        names = _printing.few(each.name for each in found.ended)
        first = found.ended[0]
        _printing.note(f"revoked, and still in the file: {names}; {first.name}: {first.way_back}")


def note_left(found: Plan) -> None:
    """Tell which changes are made on another machine."""
    if found.left:
        words = sorted({step.action.words for step in found.left})
        _printing.note(
            f"not selected, since they need the keys of the other CA: {len(found.left)}"
            f" ({', '.join(words)}); copy the keystore to the machine with those keys"
        )


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
