"""pqsec ca passphrase: change, set or remove the passphrase of the CA keys."""

from pathlib import Path

import click

from pqsec_pki.cli import _help, _passphrases, _printing, _settings
from pqsec_pki.lifecycle import change_passphrase


@_help.command(
    examples={
        "Change the passphrase": (
            "pqsec ca passphrase --passphrase-file passphrase --new-passphrase-file new-passphrase"
        ),
        "Remove it": "pqsec ca passphrase --passphrase-file new-passphrase --no-passphrase",
    },
    exit_codes={
        0: "the passphrase is changed",
        3: "not changed: the passphrase is wrong, or the keystore or a file cannot be read",
    },
)
@_passphrases.option
@click.option(
    "--new-passphrase-file",
    type=_settings.FILE,
    help="Read the new passphrase from the first line of this file.",
)
@_passphrases.weak_option
@click.option("--no-passphrase", is_flag=True, help="Leave the CA keys unencrypted.")
@_settings.command_options
def passphrase(
    passphrase_file: Path | None, new_passphrase_file: Path | None, *, no_passphrase: bool
) -> None:
    """Change, set or remove the passphrase of the CA keys.

    All keys change in one step, and the old files are overwritten with zeros. Copies may
    remain in backups, and on file systems or disks that keep old blocks. Keys of older
    generations keep their passphrase.
    """
    keystore = _settings.open_keystore(to_change=True)
    authorities = _passphrases.unlock(keystore, passphrase_file)
    new = _passphrases.new(new_passphrase_file, none=no_passphrase, option="--new-passphrase-file")
    paths = change_passphrase(keystore, authorities, new)
    if new is None:
        _passphrases.note_unencrypted(keystore.root)
    word = "not encrypted" if new is None else "encrypted again"
    value = {"keys": paths, "encrypted": new is not None}
    _printing.emit(value, [f"{path}  {word}" for path in paths])
