"""pqsec ca remove-set: remove a set of credentials that nobody needs any more."""

from pathlib import Path

import click

from pqsec_pki.cli import _help, _passphrases, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.lifecycle import RemovedSet, removable_set
from pqsec_pki.lifecycle import remove_set as remove_set_of


@_help.command(
    "remove-set",
    examples={
        "Remove the post-quantum credentials, and keep the others": (
            "pqsec -k robots ca remove-set pq --yes"
        ),
    },
    exit_codes={
        0: "the set is removed",
        1: "not removed: not confirmed",
        3: "not removed: there is no such set, it is the first one, or the keystore or the"
        " passphrase is missing or wrong",
    },
)
@click.argument("profile", metavar="PROFILE")
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@_passphrases.option
@_settings.command_options
def remove_set(profile: str, passphrase_file: Path | None, *, yes: bool) -> None:
    """Remove a set of credentials: its CAs, documents and certificates.

    Its private keys are overwritten. The files of the other sets do not change. The first set
    cannot be removed: it lies where stock stacks look for credentials.
    """
    keystore = _settings.open_keystore(to_change=True)
    view = keystore.of_profile(profile)
    if not yes:
        found = removable_set(keystore, profile, now=_settings.now())
        confirm(
            lambda: _show(found),
            "Remove it?",
            what=f"the set of credentials {profile} would be removed",
            hint="--yes removes it",
        )
    removable_set(keystore, profile, now=_settings.now())
    without = (view.set_name,)
    passphrase = _passphrases.of_cas(keystore, passphrase_file, without=without)
    authorities = _passphrases.unlocked(keystore, passphrase, without=without)
    done = remove_set_of(keystore, authorities, profile, now=_settings.now())
    for uri in done.key_uris:
        _printing.note(f"{uri} is still there: remove it with the tool of its token")
    count = _printing.counted(len(done.participants), "participant")
    _printing.emit(
        done.to_json(),
        [
            f"removed  {done.folder}: CAs, documents and valid certificates of {count}",
            "next: give every robot that had them files without them",
        ],
    )


def _show(found: RemovedSet) -> None:
    names = _printing.few(found.participants) if found.participants else "nobody"
    line = f"{found.folder} has valid certificates of {names}"
    _printing.emit(found.to_json(), [line])
