"""pqsec install and rollback: on the robot, install a bundle or return to the previous one."""

from collections.abc import Sequence
from pathlib import Path

import click

from pqsec_pki._times import said
from pqsec_pki.cli import _help, _network, _passphrases, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.cli._times import end
from pqsec_pki.cli.request import folder_option
from pqsec_pki.enrolment import install as install_bundle
from pqsec_pki.enrolment import pins_of, removed_alone
from pqsec_pki.enrolment import rollback as roll_back


@_help.command(
    examples={
        "Install the first bundle, and trust exactly these CAs (`pqsec ca show --pins`)": (
            "pqsec install robot1.bundle --ca-fingerprint identity:SHA256"
            " --ca-fingerprint permissions:SHA256 --ca-fingerprint countersigner:SHA256"
        ),
        "Install it, and trust the CAs in it": "pqsec install robot1.bundle --trust-first",
    },
    exit_codes={
        0: "installed, now or earlier",
        1: (
            "refused: the bundle is not valid under the trusted CAs, does not belong to a key"
            " here, or is older"
        ),
        3: "the bundle cannot be read, or DIR cannot be written",
    },
)
@click.argument("bundle", type=_settings.FILE)
@_network.fingerprints_option
@click.option(
    "--trust-first",
    is_flag=True,
    help="If nothing is installed yet, trust the CAs in the bundle without a check.",
)
@click.option(
    "--only", is_flag=True, help="Remove everything else that is installed, and its keys."
)
@click.option(
    "--older", is_flag=True, help="Also install a bundle that is older than the installed one."
)
@click.option(
    "--proofs",
    is_flag=True,
    help="From now on, refuse bundles that do not prove that the ledger has what is in them.",
)
@click.option("--yes", is_flag=True, help="With --only: do not ask for confirmation.")
@folder_option
@_settings.command_options
def install(  # noqa: PLR0913 -- one for each option, by name
    bundle: Path,
    fingerprints: tuple[str, ...],
    folder: Path,
    *,
    trust_first: bool,
    older: bool,
    only: bool,
    proofs: bool,
    yes: bool,
) -> None:
    """Check a bundle and install it on this robot.

    Everything in the bundle must be valid now under the trusted CAs, and belong to a key on
    this robot. Then DIR/current is switched, in one step, to a folder with the bundle and
    everything else that is installed. The previous folder is kept for `pqsec rollback`.

    A bundle can prove that its certificates and documents are in the ledger of which the CAs
    signed a head. A wrong proof is refused; a missing one only after --proofs was given here once.

    All sets of credentials are installed together. A set that the keystore added is accepted if
    such a proof has its CAs, and is then needed: a bundle without it is refused, also with --older.

    DIR/installed.receipt then says what is installed, signed with the keys of this robot: copy
    it to the machine with the CAs, for `pqsec receipt import`. To make it again, install the
    same bundle again.
    """
    removed = removed_alone(bundle, folder) if only and not yes else None
    if removed:
        _ask(removed)
    done = install_bundle(
        bundle,
        folder,
        pins_of(fingerprints),
        now=_settings.now(),
        trust_first=trust_first,
        older=older,
        proofs=proofs,
        alone=only,
        agreed=removed,
        pin=_passphrases.pin,
    )
    for each in done.future:
        _printing.note(str(each))
    word = "was already installed" if done.already else "installed"
    until = f"until {end(done.not_after)}"
    _printing.emit(done.to_json(), [f"{', '.join(done.names)}  {word}, {until}  {done.current}"])


def _ask(removed: Sequence[str]) -> None:
    """Ask: keys that were generated on the robot are nowhere else."""
    confirm(
        lambda: _printing.emit(None, [f"remove: {name}" for name in removed]),
        "Remove these and their keys?",
        what=f"{_printing.few(removed)} would be removed, with the keys",
        hint="--yes removes them; without --only they stay",
    )


@_help.command(
    examples={
        "Return to what was installed before the last bundle, which is older": (
            "pqsec rollback --older"
        ),
    },
    exit_codes={
        0: "restored",
        1: "refused: it is older than the newest installed bundle, or from other CAs",
        3: "nothing to restore, or DIR cannot be written",
    },
)
@click.option("--older", is_flag=True, help="Also restore something older, or from other CAs.")
@folder_option
@_settings.command_options
def rollback(folder: Path, *, older: bool) -> None:
    """Restore what was installed before the last bundle.

    It works once, and destroys nothing: install the bundle again to undo it. Something older
    than the newest installed bundle is refused, unless you use --older: it may grant rights
    that were withdrawn, and accept peers that were revoked. The expiry of its certificates is
    not checked. What lacks a set of credentials that was installed since is always refused.
    """
    earlier = roll_back(folder, now=_settings.now(), older=older, pin=_passphrases.pin)
    value = {"current": earlier.path, "installed_at": earlier.at}
    _printing.emit(value, [f"restored what was installed {said(earlier.at)}  {folder}"])
