"""pqsec ca add-set: add a set of credentials of another profile to a keystore that runs."""

from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki.algorithms import PROFILES, profile_named
from pqsec_pki.cli import _help, _key_uris, _passphrases, _printing, _settings
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import key_algorithms
from pqsec_pki.lifecycle import add_set as add_set_of


@_help.command(
    "add-set",
    examples={
        "Add hybrid credentials beside the classical ones": "pqsec -k robots ca add-set hybrid",
    },
    exit_codes={
        0: "the set is added",
        3: "not added: there is such a set, a document cannot be signed again as it is, or the"
        " keystore or the passphrase is missing or wrong",
    },
)
@click.argument(
    "profile_name",
    metavar="PROFILE",
    type=click.Choice([profile.name for profile in PROFILES], case_sensitive=False),
)
@click.option("--name", help="Start the names of the CAs with this. [default: as the first set's]")
@click.option(
    "--validity",
    type=_settings.Duration(),
    default="10y",
    show_default=True,
    help="Issue the CA certificates for this long.",
)
@_key_uris.options
@_passphrases.option
@_passphrases.weak_option
@click.option(
    "--no-passphrase",
    is_flag=True,
    help="Leave the new CA keys unencrypted, if those of the other sets are in tokens.",
)
@_settings.command_options
def add_set(
    profile_name: str,
    name: str | None,
    validity: timedelta,
    passphrase_file: Path | None,
    *,
    no_passphrase: bool,
) -> None:
    """Add a set of credentials of another profile.

    New CAs sign the same governance and permissions, and certify new keys of all participants whose
    keys are in the keystore. The files of the other sets do not change. The new CA keys get the
    passphrase of the others, or a new one if no other is in a file.
    """
    keystore = _settings.open_keystore(to_change=True)
    profile, has_files = profile_named(profile_name), keystore.has_keys_in_files()
    if no_passphrase and has_files:
        raise UsageError(
            "the keys of all sets of credentials have one passphrase",
            hint="leave out --no-passphrase; `pqsec ca passphrase` changes it",
        )
    passphrase = _passphrases.of_cas(keystore, passphrase_file)
    authorities, algorithms = _passphrases.unlocked(keystore, passphrase), key_algorithms(profile)
    with _key_uris.keys(algorithms, _key_uris.given()) as keys:
        if not has_files and len(keys) < len(algorithms):
            passphrase = _passphrases.new(passphrase_file, none=no_passphrase)
        added = add_set_of(
            keystore,
            authorities,
            profile,
            name=name,
            validity=validity,
            passphrase=passphrase,
            keys=keys,
            now=_settings.now(),
        )
    if added.left:
        _printing.note(
            f"without a certificate of the new set: {_printing.few(added.left)}: their keys are not"
            " here, or they have no valid certificate"
        )
    _printing.emit(
        {"set": added.keystore.folder, "issued": added.issued, "left": added.left},
        [f"set  {added.keystore.folder}", *("  ".join(each.row) for each in added.issued)],
    )
