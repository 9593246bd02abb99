"""pqsec propose: propose one command to those who must approve it."""

from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.approvals import approve, proposal_file
from pqsec_pki.cli import _approver, _help, _printing, _proposed, _settings
from pqsec_pki.cli.approve import lines
from pqsec_pki.cli.plan import refuse_output
from pqsec_pki.domain import propose_command


@click.command(
    cls=_help.Command,
    context_settings={"allow_interspersed_args": False},
    examples={
        "Propose to revoke a stolen robot": (
            "pqsec propose -o plan.json --key alice.pem revoke /fleet/robot1 --reason keyCompromise"
        ),
        "Propose new CAs": "pqsec propose -o plan.json --key alice.pem ca rotate --apply",
    },
    exit_codes={
        0: "proposed",
        1: "not proposed: the key is not an approver's, or a file that is named is not valid",
        3: "not proposed: the keystore demands no approvals, or a file cannot be read or written",
    },
)
@click.option(
    "-o",
    "--output",
    type=_settings.FILE,
    required=True,
    metavar="PLAN.json",
    help="Write the proposal to this file, for `pqsec approve` and `pqsec apply`.",
)
@click.option(
    "--key",
    required=True,
    metavar="FILE|URI",
    help="Your private key, which must be an approver's.",
)
@click.option(
    "--validity",
    type=_settings.Duration(),
    default="7d",
    show_default=True,
    help="It can be approved and applied this long.",
)
@click.option("--force", is_flag=True, help="Replace the file.")
@click.argument("words", nargs=-1, required=True, type=click.UNPROCESSED, metavar="COMMAND...")
@_approver.passphrase_option
@_settings.command_options
def propose(  # noqa: PLR0913 -- one for each option, by name
    words: tuple[str, ...],
    output: Path,
    key: str,
    validity: timedelta,
    key_passphrase_file: Path | None,
    *,
    force: bool,
) -> None:
    """Propose one command to those who must approve it.

    COMMAND is the command with its arguments, without `pqsec`. The proposal is of exactly these
    words, the files that they name, and this state of the keystore, and counts as an approval by
    its maker. `pqsec approve` approves it, and `pqsec apply` runs the command, once.
    """
    refuse_output(output, force=force)
    keystore, now = _settings.open_keystore(), _settings.now()
    review = _proposed.review_of(words, keystore)
    signer = _approver.key_at(key, key_passphrase_file)
    name = _approver.name_in(keystore.approvals, signer)
    proposal = propose_command(review, keystore, proposer=name, now=now, validity=validity)
    first = approve(proposal.digest, name, signer, now=now)
    _files.write(output, proposal_file(proposal, first), force=force)
    _printing.emit({"written": output, **proposal.to_json()}, lines(proposal, output))
