"""Reads the files of a participant's enclave."""

import os
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from pqsec_pki._files import disk_errors, exists, read, read_within, real_path
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials import FILES, KEYS, NEEDED, Credentials, only_certificate, only_list
from pqsec_pki.errors import FileError, KeystoreError, located
from pqsec_pki.keystore import layout
from pqsec_pki.keystore.patterns import nearest
from pqsec_pki.problems import Code
from pqsec_pki.tokens import stored_pin

_PUBLIC = tuple(each for each in FILES if each not in KEYS)


def load_participant(root: Path, name: str, passphrase: bytes | None = None) -> Credentials:
    """The participant called `name` in the keystore at `root`, with its keys, also in tokens.

    KeystoreError if there is none or a file is missing, MalformedError for a file that
    cannot be read, PassphraseError for an encrypted key without `passphrase`.
    """
    folder = root / layout.enclave_folder(name)
    files = _files(root, name, FILES, (*NEEDED, layout.KEY), {})
    return Credentials.of(name, files, passphrase, pin=stored_pin, folder=folder)


def enclave_files(
    root: Path, name: str, linked: dict[str, bytes] | None = None
) -> dict[str, bytes]:
    """The files of the participant called `name`, links followed, by their names in FILES.

    A caller that reads many participants passes the same `linked`, so that shared files are read
    once. Files that are not NEEDED may be missing. KeystoreError if there is no such participant,
    or a needed file is missing. FileError for a link that leads out of the keystore, or a key that
    is a link: a bundle must not contain other files of this machine.
    """
    return _files(root, name, FILES, NEEDED, {} if linked is None else linked)


def public_files(root: Path, name: str, linked: dict[str, bytes] | None = None) -> dict[str, bytes]:
    """Like `enclave_files`, but the keys are not opened."""
    return _files(root, name, _PUBLIC, NEEDED, {} if linked is None else linked)


def _files(
    root: Path,
    name: str,
    wanted: tuple[str, ...],
    needed: tuple[str, ...],
    linked: dict[str, bytes],
) -> dict[str, bytes]:
    refuse_unknown(root, name)
    folder = root / layout.enclave_folder(name)
    with disk_errors(folder):
        with os.scandir(folder) as found:
            is_link = {each.name: each.is_symlink() for each in found}
        known = [each for each in wanted if each in is_link]
        links = {each for each in known if is_link[each]}
        there = [each for each in known if each not in links or exists(folder / each)]
        _refuse_incomplete(folder, name, there, needed, links)
        real, files, shared = real_path(root), {}, links.difference(KEYS)
        for each in there:
            path = folder / each
            # Without pathlib: bundles are made of thousands of files.
            goal = os.path.normpath(f"{folder}/{os.readlink(path)}") if each in shared else ""  # noqa: PTH115
            data = linked.get(goal) or read_within(real, path, follow=each not in KEYS)
            files[each] = data
            if goal:
                linked[goal] = data
        return files


def refuse_unknown(root: Path, name: str) -> None:
    """KeystoreError if the keystore at `root` has no certificate of a participant `name`."""
    folder = root / layout.enclave_folder(name)
    if exists(folder / layout.CERTIFICATE, follow=False):
        return
    if layout.is_there(root, name):
        raise KeystoreError(
            f"{folder} lacks {layout.CERTIFICATE}",
            code=Code.FILE_MISSING,
            hint=f"restore it from a backup; or issue it again, with new keys and permissions:"
            f" pqsec issue {name} --force ...",
        )
    suggestion = ""
    with suppress(FileError):  # the name is missing whatever the other folders are
        suggestion = nearest(name, list(layout.names_in(root)))
    hint = f"issue it with `pqsec issue {name}`; `pqsec ca show` lists the participants"
    raise KeystoreError(
        f"there is no participant {name} in {root}",
        code=Code.FILE_MISSING,
        hint=f"{suggestion} If not, {hint}" if suggestion else hint,
    )


def load_certificate(path: Path) -> Certificate:
    """The only certificate in PEM file `path`; errors name the file."""
    return only_certificate(read(path), str(path))


def load_first_certificate(path: Path) -> Certificate:
    """The first certificate in PEM file `path`: in a CA's file, the issuing CA."""
    with located(path):
        return _first_certificate(read(path))


@lru_cache(maxsize=8)
def _first_certificate(data: bytes) -> Certificate:
    """The first certificate in PEM `data`, cached: each change asks for those of the CAs."""
    return Certificate.from_pem(data)


def load_revocation_list(path: Path) -> RevocationList:
    """The revocation list in PEM file `path`; errors name the file."""
    return only_list(read(path), str(path))


def _refuse_incomplete(
    folder: Path, name: str, there: list[str], needed: tuple[str, ...], links: set[str]
) -> None:
    """KeystoreError that names the missing files; ROS 2 does not name them.

    A broken link to a revocation list counts as missing: ROS 2 then revokes nothing.
    """
    missing = [each for each in FILES if each not in there and each in {*needed, *links}]
    if missing == [layout.KEY] and exists(folder / layout.REQUEST):
        raise KeystoreError(
            f"{folder} lacks {layout.KEY}: its keys are on its robot",
            hint="`pqsec check` and `pqsec explain` work without its keys",
            code=Code.FILE_MISSING,
        )
    if missing:
        lost = [_target(folder / each) for each in missing if each in links]
        hint = f"restore {', '.join(lost)}, which all participants share" if lost else None
        if layout.PERMISSIONS in missing:
            hint = hint or (
                f"restore it, or issue it again: pqsec issue {name} --force ...; if it was issued"
                f" with --certificate-only: pqsec permit {name} ..."
            )
        raise KeystoreError(
            f"{folder} lacks {', '.join(missing)}", hint=hint, code=Code.FILE_MISSING
        )


def _target(link: Path) -> str:
    """The path that the link leads to, relative to the working directory."""
    return os.path.normpath(link.parent / link.readlink())
