"""pqsec request and bundle-key: generate keys on the robot, before enrolment."""

from pathlib import Path

import click

from pqsec_pki.algorithms import profile_named
from pqsec_pki.cli import _completion, _help, _printing, _settings
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
    help="Keep this robot's credentials in DIR.",
)


@_help.command(
    examples={
        "Generate keys on the robot": "pqsec request /fleet/robot3",
        "Use the profile of the keystore": (
            "pqsec request /fleet/robot4 --profile pq --dir credentials"
        ),
    },
    exit_codes={
        0: "the request is written",
        3: "there is a request already, or DIR cannot be written",
    },
)
@click.argument("name")
@profile_option
@click.option(
    "--participant-key",
    metavar="NAME",
    help="Choose another kind of key.",
    shell_complete=_completion.signatures,
)
@click.option(
    "--alt-key",
    metavar="NAME",
    help="Choose another kind of alternative key.",
    shell_complete=_completion.signatures,
)
@folder_option
@click.option("--force", is_flag=True, help="Replace an existing request for NAME, and its keys.")
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
    """Generate keys and a certificate request on the robot.

    The keys stay in DIR. Copy the request.csr that is printed to the machine with the CAs,
    for `pqsec issue --csr`. The profile must be the same as the keystore's.
    """
    profile = profile_named(profile_name).changed(
        {"participant_key": participant_key, "alternative_key": alt_key}
    )
    made = make_request(name, profile, folder, force=force)
    value = {"name": made.name, "request": made.path, "sha256": made.request.fingerprint}
    _printing.emit(value, [f"{made.name}  {made.path}"])


@_help.command(
    "bundle-key",
    examples={
        "Generate the key": "pqsec bundle-key",
    },
    exit_codes={
        0: "the key is written",
        3: "there is a key already, or DIR cannot be written",
    },
)
@folder_option
@click.option(
    "--force",
    is_flag=True,
    help="Replace an existing key: bundles for the old key can no longer be opened.",
)
@_settings.command_options
def bundle_key(folder: Path, *, force: bool) -> None:
    """Generate the robot's key for opening sealed bundles.

    Copy the bundle.pub.pem that is printed to the machine with the CAs, for --seal-for.
    """
    path, sha256 = make_sealing_key(folder, force=force)
    _printing.emit({"public_key": path, "sha256": sha256}, [f"{path}  SHA-256 {sha256}"])
