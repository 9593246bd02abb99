"""A participant as it lies in its enclave: its files, and what they say."""

import os
from contextlib import suppress
from pathlib import Path

from pqsec_pki._files import disk_errors, exists, read, read_within
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials import FILES, KEYS, NEEDED, Credentials, only_certificate, only_list
from pqsec_pki.errors import FileError, KeystoreError, located, meant
from pqsec_pki.keystore import _layout
from pqsec_pki.problems import Code


def load_participant(root: Path, name: str, passphrase: bytes | None = None) -> Credentials:
    """The participant called `name` in the keystore at `root`, with its keys.

    KeystoreError if there is none or a file is missing, MalformedError for a file that
    cannot be read, PassphraseError for an encrypted key without `passphrase`.
    """
    folder = root / _layout.enclave_folder(name)
    files = _files(root, name, (*NEEDED, _layout.KEY))
    return Credentials.of(name, files, passphrase, folder=folder)


def enclave_files(root: Path, name: str) -> dict[str, bytes]:
    """The files of the participant called `name`, links followed, by their names in FILES.

    Those that are not NEEDED may be missing. KeystoreError if there is no such
    participant, or it lacks one that is; FileError for a link that leads out of the keystore,
    or a key that is a link: who bundles a keystore of somebody else's hands on nothing else.
    """
    return _files(root, name, NEEDED)


def _files(root: Path, name: str, needed: tuple[str, ...]) -> dict[str, bytes]:
    refuse_unknown(root, name)
    folder = root / _layout.enclave_folder(name)
    with disk_errors(folder):
        there = [each for each in FILES if exists(folder / each)]
        _refuse_incomplete(folder, name, there, needed)
        return {each: read_within(root, folder / each, follow=each not in KEYS) for each in there}


def refuse_unknown(root: Path, name: str) -> None:
    """KeystoreError if the keystore at `root` has no certificate of a participant `name`."""
    folder = root / _layout.enclave_folder(name)
    if exists(folder / _layout.CERTIFICATE, follow=False):
        return
    if _layout.is_there(root, name):
        raise KeystoreError(
            f"{folder} lacks {_layout.CERTIFICATE}",
            code=Code.FILE_MISSING,
            hint=f"restore it from a backup; or make all anew, its keys and permissions too:"
            f" pqsec issue {name} --force ...",
        )
    instead = ""
    with suppress(FileError):  # that this one is not there is known all the same
        instead = meant(name, _layout.names_in(root))
    way = f"make it with `pqsec issue {name}`; `pqsec ca show` lists those there are"
    raise KeystoreError(
        f"there is no participant {name} in {root}",
        code=Code.FILE_MISSING,
        hint=f"{instead} If not, {way}" if instead else way,
    )


def load_certificate(path: Path) -> Certificate:
    """The only certificate in PEM file `path`; errors name the file."""
    return only_certificate(read(path), str(path))


def load_first_certificate(path: Path) -> Certificate:
    """The first one, for who then compares it, or the CA that issues: others trust all there."""
    with located(path):
        return Certificate.from_pem(read(path))


def load_revocation_list(path: Path) -> RevocationList:
    """The revocation list in PEM file `path`; errors name the file."""
    return only_list(read(path), str(path))


def _refuse_incomplete(folder: Path, name: str, there: list[str], needed: tuple[str, ...]) -> None:
    """KeystoreError for what is missing; ROS 2 does not say which file it misses.

    Nor does it say that a link to a revocation list leads nowhere: it takes everybody.
    """
    links = {each for each in FILES if (folder / each).is_symlink()}
    missing = [each for each in FILES if each not in there and each in {*needed, *links}]
    if missing == [_layout.KEY] and exists(folder / _layout.REQUEST):
        raise KeystoreError(
            f"{folder} lacks {_layout.KEY}: its keys are on its robot",
            hint="what is here can be checked without them: `pqsec check`, `pqsec explain`",
            code=Code.FILE_MISSING,
        )
    if missing:
        lost = [_shown_by(folder / each) for each in missing if each in links]
        hint = f"restore {', '.join(lost)}, which all participants share" if lost else None
        if _layout.PERMISSIONS in missing:
            hint = hint or f"put it back, or say what it may do: pqsec issue {name} --force ..."
        raise KeystoreError(
            f"{folder} lacks {', '.join(missing)}", hint=hint, code=Code.FILE_MISSING
        )


def _shown_by(link: Path) -> str:
    """What the link should show, as a path from where the user is."""
    return os.path.normpath(link.parent / link.readlink())
