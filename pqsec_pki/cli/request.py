"""pqsec request and bundle-key: on the robot, before it is enrolled."""

from pathlib import Path

import click

from pqsec_pki.algorithms import profile_named
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli.ca import profile_option
from pqsec_pki.enrolment import make_sealing_key
from pqsec_pki.enrolment import request as make_request

folder_option = click.option(
    "--dir",
    "-o",
    "folder",
    type=_settings.FOLDER,
    default=Path("credentials"),
    show_default=True,
    metavar="DIR",
    help="Where this robot keeps its credentials.",
)


@click.command()
@click.argument("name")
@profile_option
@click.option("--participant-key", metavar="NAME", help="Another kind of key.")
@click.option("--alt-key", metavar="NAME", help="Another alternative key.")
@folder_option
@click.option("--force", is_flag=True, help="Replace a request for NAME, and its keys.")
@_settings.command_options
def request(  # noqa: PLR0913 -- one for each option, by name
    name: str,
    profile_name: str,
    participant_key: str | None,
    alt_key: str | None,
    folder: Path,
    *,
    force: bool,
) -> None:
    """Make keys on the robot, and the request for their certificate.

    The keys stay in DIR; send the request.csr that is printed to where the CAs are, for
    `pqsec issue --csr`. The profile must be the keystore's.
    """
    profile = profile_named(profile_name).changed(
        {"participant_key": participant_key, "alternative_key": alt_key}
    )
    made = make_request(name, profile, folder, force=force)
    value = {"name": made.name, "request": str(made.path), "sha256": made.request.fingerprint}
    _printing.emit(value, [f"{made.name}  {made.path}"])


@click.command("bundle-key")
@folder_option
@click.option("--force", is_flag=True, help="Replace the key: older bundles cannot be opened then.")
@_settings.command_options
def bundle_key(folder: Path, *, force: bool) -> None:
    """Make the key on the robot with which it opens sealed bundles.

    Send the bundle.pub.pem that is printed to where the CAs are, for --seal-for.
    """
    path, sha256 = make_sealing_key(folder, force=force)
    _printing.emit({"public_key": str(path), "sha256": sha256}, [f"{path}  SHA-256 {sha256}"])
