"""pqsec approve: approve a plan that somebody proposed with `pqsec plan -o`."""

from collections.abc import Iterator
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki._times import said
from pqsec_pki.approvals import (
    MAX_PROPOSAL,
    Approval,
    ChangedRights,
    PlanProposal,
    approval_in,
    proposal_in,
)
from pqsec_pki.approvals import approve as approval_by
from pqsec_pki.cli import _approver, _help, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.errors import FileError, VerificationError, located

MAX_APPROVAL = 64 << 10
"""Bytes; the largest signature has 7 kB in base64."""


@_help.command(
    examples={
        "Approve with a key in a file": "pqsec approve plan.json --key bob.pem --yes",
    },
    exit_codes={
        0: "approved: the approval is in a file beside PLAN",
        1: "not approved: the plan was changed or has expired, or the key is not an approver's",
        3: "PLAN or the key cannot be read",
    },
)
@click.argument("plan", type=_settings.FILE, metavar="PLAN")
@click.option(
    "--key",
    required=True,
    metavar="FILE|URI",
    help="Your private key, or its place in a token: pkcs11:token=LABEL;object=LABEL",
)
@click.option(
    "-o",
    "--output",
    type=_settings.FILE,
    help="Write the approval to this file.  [default: PLAN.NAME.approval]",
)
@click.option("--force", is_flag=True, help="Replace the file.")
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@_approver.passphrase_option
@_settings.command_options
def approve(  # noqa: PLR0913 -- one for each option, by name
    plan: Path,
    key: str,
    output: Path | None,
    key_passphrase_file: Path | None,
    *,
    force: bool,
    yes: bool,
) -> None:
    """Approve a plan that somebody proposed with `pqsec plan -o` or `pqsec propose`.

    Shows what the plan would change, and signs exactly that: these changes, this domain file and
    this state of the keystore. No keystore is needed. Send the file that it writes to the person
    who applies the plan.
    """
    proposal, _ = read_proposal(plan)
    now = _settings.now()
    with located(plan):
        proposal.refuse_expired(now)
    signer = _approver.key_at(key, key_passphrase_file)
    name = _approver.name_in(proposal.policy, signer)
    if name == proposal.proposer:
        raise VerificationError(f"{name} proposed this plan, which counts as an approval")
    goal = output or approval_path(plan, name)
    if not force:
        _files.refuse_existing(goal)
    if not yes:
        _ask(proposal, plan, name)
    approval = approval_by(proposal.digest, name, signer, now=now)
    _files.write(goal, approval.to_file(), force=force)
    value = {"plan": proposal.digest, "approver": name, "written": goal}
    _printing.emit(value, [f"approved by {name}: {goal}"])


def _ask(proposal: PlanProposal, plan: Path, name: str) -> None:
    confirm(
        lambda: _printing.emit(None, lines(proposal, plan)),
        f"Approve this as {name}?",
        what=f"{len(proposal.steps)} changes would be approved"
        if proposal.domain_file
        else "a command would be approved",
        hint="--yes approves; without it, the changes are shown first",
    )


def lines(proposal: PlanProposal, plan: Path) -> Iterator[str]:
    """All that would be approved."""
    yield f"plan {proposal.digest}"
    yield f"by {proposal.proposer}, until {said(proposal.expires)}"
    if proposal.domain_file:
        yield f"domain file: {proposal.domain_file}, {_state_of(proposal, plan)}"
    if proposal.only:
        yield f"only what needs the keys of the {proposal.only} CA"
    yield f"state of the keystore: {proposal.head}"
    alike: dict[tuple[str, str], list[str]] = {}
    for step in proposal.steps:
        alike.setdefault((step.action, step.why), []).append(step.name)
    for (action, why), names in alike.items():
        yield f"{action}: {', '.join(names)} ({why})" if any(names) else f"{action}: {why}"
    for each in proposal.rights:
        yield f"{_whose(proposal, each)}:"
        yield from (f"  {change}" for change in each.changes)
    if proposal.needs:
        kinds = ", ".join(each.words for each in proposal.needs)
        yield f"approvals: {proposal.policy.required} are needed ({kinds})"


def _whose(proposal: PlanProposal, changed: ChangedRights) -> str:
    if changed.names:
        return f"{'rights of ' * bool(proposal.domain_file)}{', '.join(changed.names)}"
    return "governance" if proposal.domain_file else "it would"


def _state_of(proposal: PlanProposal, plan: Path) -> str:
    """Whether the domain file that the plan names is the one that it was made of."""
    import hashlib  # noqa: PLC0415 -- only here

    try:
        found = _files.read(plan.parent / proposal.domain_file)
    except FileError:
        return f"which is not here; its SHA-256 was {proposal.domain_sha256}"
    same = hashlib.sha256(found).hexdigest() == proposal.domain_sha256
    return "as it is here" if same else "which DIFFERS here"


def read_proposal(path: Path) -> tuple[PlanProposal, Approval]:
    """The proposal in that file, and its proposer's approval."""
    with located(path):
        return proposal_in(_files.read(path, limit=MAX_PROPOSAL))


def read_approval(path: Path) -> Approval:
    """The approval in that file."""
    with located(path):
        return approval_in(_files.read(path, limit=MAX_APPROVAL))


def approval_path(plan: Path, name: str) -> Path:
    """The path of the approval by that approver, unless an option names it."""
    return plan.with_name(f"{plan.name}.{name}.approval")
