"""pqsec request and bundle-key: generate keys on the robot, before enrolment."""

from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.algorithms import DEFAULT_PROFILE
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.cli import _completion, _help, _key_uris, _passphrases, _printing, _settings
from pqsec_pki.cli.ca import Profiles, profiles_of
from pqsec_pki.enrolment import make_sealing_key
from pqsec_pki.enrolment import requests as make_requests

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
        "Request for all nodes of a robot, in one file": (
            "pqsec request /tb3/nav /tb3/arm --csr tb3.csr"
        ),
        "Use the profile of the keystore": (
            "pqsec request /fleet/robot4 --profile pq --dir credentials"
        ),
    },
    exit_codes={
        0: "all requests are written",
        3: "nothing is written: there is a request or FILE already, a pattern matches nothing, or"
        " DIR cannot be written",
    },
)
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@click.option(
    "--profile",
    "profile_names",
    type=Profiles(),
    default=DEFAULT_PROFILE.name,
    show_default=True,
    help="Make keys of this profile; of several, with commas between them, if the keystore has a"
    " set of credentials for each.",
)
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
@_key_uris.participant_options
@folder_option
@click.option("--csr", type=_settings.FILE, metavar="FILE", help="Write all requests to FILE too.")
@click.option(
    "--force", is_flag=True, help="Replace FILE, and existing requests for NAME, with their keys."
)
@_settings.command_options
def request(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    profile_names: tuple[str, ...],
    participant_key: str | None,
    alt_key: str | None,
    folder: Path,
    *,
    csr: Path | None,
    force: bool,
) -> None:
    """Generate keys and certificate requests on the robot.

    The keys stay in DIR, or in the places of the --...-uri options: a key that is there is used,
    another one is generated there. Copy each request.csr that is printed, or the FILE with all of
    them, to the machine with the CAs, for `pqsec issue --csr` or `pqsec sign-request export`. The
    profiles must be the keystore's. A set of credentials that is installed here keeps its keys if
    another one is not. A pattern such as '/tb3/*' matches the participants
    that were requested or installed in DIR before: with --force they get new keys.
    """
    if csr and not force:
        _files.refuse_existing(csr)
    profile, *further = profiles_of(
        profile_names, {"participant_key": participant_key, "alternative_key": alt_key}
    )
    uris = _key_uris.given_for_participant()
    made = make_requests(
        names,
        profile,
        folder,
        further=further,
        uris=uris,
        pin=_passphrases.pin,
        together=csr is not None,
        force=force,
    )
    _key_uris.note_participant(profile, uris, made[0].generated)
    if csr:
        with _printing.with_hint(f"the requests are in {folder}: join their files"):
            _files.write(
                csr, CertificateRequest.all_to_pem([each.request for each in made]), force=force
            )
    rows = [
        {"name": each.name, "request": each.path, "sha256": each.request.fingerprint}
        for each in made
    ]
    lines = [f"{each.name}  {each.path}" for each in made]
    _printing.emit({"requests": rows, "csr": csr}, [*lines, *([str(csr)] if csr else [])])


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
