"""The file of a proposed plan with its approvals, as `pqsec apply` takes it."""

from pathlib import Path

import click

from pqsec_pki._files import is_there
from pqsec_pki.approvals import Approval, PlanProposal
from pqsec_pki.cli import _printing, _proposed, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.cli.approve import approval_path, read_approval, read_proposal
from pqsec_pki.cli.approve import lines as proposal_lines
from pqsec_pki.cli.plan import PROPOSAL_SUFFIX
from pqsec_pki.domain import (
    ApprovedPlan,
    Desired,
    approved_command,
    approved_plan,
    command_in,
    read_domain,
)
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore


def command_of(file: Path, *, is_chosen: bool) -> list[str] | None:
    """The words of the command in a plan; None if the file is another plan, or a domain file."""
    if file.suffix != PROPOSAL_SUFFIX:
        return None
    if is_chosen:
        raise UsageError("--prune, --new-keys and --only are for a domain file, not for a plan")
    return command_in(read_proposal(file)[0])


def refuse_choices(**given: bool) -> None:
    """UsageError for an option that a plan of one command does not have."""
    for name, is_given in given.items():
        if is_given:
            raise UsageError(f"--{name} is not for a plan of one command")


def run_command(  # noqa: PLR0913 -- the options of the command
    words: list[str],
    file: Path,
    approval_files: tuple[Path, ...],
    passphrase_file: Path | None,
    *,
    yes: bool,
    none: bool,
) -> None:
    """Run the command of a plan, if enough people approved it."""
    proposal, approvals = _approved(file, approval_files)
    keystore = _settings.open_keystore(to_change=True)
    if not yes:
        confirm(
            lambda: _printing.emit(None, proposal_lines(proposal, file)),
            "Run this command?",
            what="a command would be run",
            hint="--yes runs it; `pqsec approve` shows it",
        )
    with keystore.hold():
        review = _proposed.review_of(words, keystore)
        with approved_command(proposal, approvals, review, keystore, now=_settings.now()):
            code = _proposed.run(words, passphrase_file, no_passphrase=none)
    if code:
        click.get_current_context().exit(code)


def plan_in(
    file: Path, approval_files: tuple[Path, ...], *, to_change: bool
) -> tuple[Desired, Keystore, ApprovedPlan]:
    """The plan that enough people approved, with its domain file and the keystore."""
    proposal, approvals = _approved(file, approval_files)
    keystore = _settings.open_keystore(to_change=to_change)
    desired = read_domain(file.parent / proposal.domain_file)
    approved = approved_plan(proposal, approvals, desired, keystore, now=_settings.now())
    return desired, keystore, approved


def _approved(file: Path, approval_files: tuple[Path, ...]) -> tuple[PlanProposal, list[Approval]]:
    """The plan in the file, and the approvals of it."""
    proposal, first = read_proposal(file)
    beside = [approval_path(file, name) for name in proposal.policy.approvers]
    places = approval_files or [path for path in beside if is_there(path)]
    return proposal, [first, *map(read_approval, places)]
