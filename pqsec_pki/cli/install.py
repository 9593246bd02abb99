"""pqsec install and rollback: on the robot, the answer to its request, and the way back."""

from pathlib import Path

import click

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli.request import folder_option
from pqsec_pki.enrolment import install as install_bundle
from pqsec_pki.enrolment import pins_of
from pqsec_pki.enrolment import rollback as roll_back


@click.command()
@click.argument("bundle", type=_settings.FILE)
@click.option(
    "--ca-fingerprint",
    "fingerprints",
    multiple=True,
    metavar="ROLE:SHA256",
    help="Of a CA to trust, and as what: identity, permissions or countersigner; name each."
    " [default: those that are trusted here]",
)
@click.option(
    "--trust-first",
    is_flag=True,
    help="If nothing is installed yet, trust the CAs in the bundle, whoever made it.",
)
@click.option("--only", is_flag=True, help="Let go what else is installed, and its keys.")
@click.option("--older", is_flag=True, help="Also what is older than what is installed.")
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
) -> None:
    """Check a bundle, and let it be what this robot runs with.

    Everything in it must hold now, under the CAs that are trusted, and fit a key that is
    here. Then DIR/current leads to it and to what else is installed, in one step; what was
    there before is kept for `pqsec rollback`.
    """
    done = install_bundle(
        bundle,
        folder,
        pins_of(fingerprints),
        now=_settings.now(),
        trust_first=trust_first,
        older=older,
        alone=only,
    )
    value = {
        "installed": done.names,
        "current": str(done.current),
        "not_after": done.not_after.isoformat(),
        "already": done.already,
    }
    word = "was installed already" if done.already else "installed"
    until = f"until {done.not_after:%Y-%m-%d}"
    _printing.emit(value, [f"{', '.join(done.names)}  {word}, {until}  {done.current}"])


@click.command()
@click.option("--older", is_flag=True, help="Also to what is older, or of other CAs.")
@folder_option
@_settings.command_options
def rollback(folder: Path, *, older: bool) -> None:
    """Go back to what was installed before the last bundle, once.

    What is older than the newest that was installed here is refused: it may grant rights that
    were withdrawn, and let in peers that were revoked. --older takes it all the same. Whether its
    certificates have expired is not checked.
    """
    earlier = roll_back(folder, older=older)
    value = {"current": str(earlier.path), "installed_at": earlier.at.isoformat()}
    _printing.emit(value, [f"back to what was installed {earlier.at:%Y-%m-%d %H:%M} UTC  {folder}"])
