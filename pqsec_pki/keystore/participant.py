"""A participant as it lies in its enclave: keys, certificate, documents, and whom it trusts."""

from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from pqsec_pki._files import disk_errors, exists, read
from pqsec_pki.algorithms import PrivateKey, load_private_key
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.errors import FileError, KeystoreError, located, meant
from pqsec_pki.keystore import _layout


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Participant:
    """Everything one participant runs with, as read: nothing of it is verified here."""

    name: str
    certificate: Certificate
    key: PrivateKey = field(repr=False)
    alternative_key: PrivateKey | None = field(repr=False)
    permissions: bytes = field(repr=False)
    """The signed permissions document, S/MIME."""
    governance: bytes = field(repr=False)
    """The signed governance document, S/MIME."""
    identity_ca: Certificate
    permissions_ca: Certificate
    permissions_alt_ca: Certificate | None
    """Signer of countersignatures, where the profile has them."""
    revocation_list: RevocationList | None = None
    """The identity CA's, once it has taken certificates back."""


def load_participant(root: Path, name: str, passphrase: bytes | None = None) -> Participant:
    """The participant called `name` in the keystore at `root`.

    KeystoreError if there is none or a file is missing, MalformedError for a file that
    cannot be read, PassphraseError for an encrypted key without `passphrase`.
    """
    folder = root / _layout.enclave_folder(name)
    with disk_errors(folder):
        return _load(root, folder, name, passphrase)


def _load(root: Path, folder: Path, name: str, passphrase: bytes | None) -> Participant:
    refuse_unknown(root, name)
    _check_complete(folder, name)
    alternative = folder / _layout.ALT_KEY
    alt_ca = folder / _layout.PERMISSIONS_ALT_CA
    revoked = folder / _layout.LIST
    return Participant(
        name=name,
        certificate=load_certificate(folder / _layout.CERTIFICATE),
        key=_key(folder / _layout.KEY, passphrase),
        alternative_key=_key(alternative, passphrase) if exists(alternative) else None,
        permissions=read(folder / _layout.PERMISSIONS),
        governance=read(folder / _layout.GOVERNANCE),
        identity_ca=load_certificate(folder / _layout.IDENTITY_CA),
        permissions_ca=load_certificate(folder / _layout.PERMISSIONS_CA),
        permissions_alt_ca=load_certificate(alt_ca) if exists(alt_ca) else None,
        revocation_list=load_revocation_list(revoked) if exists(revoked) else None,
    )


def refuse_unknown(root: Path, name: str) -> None:
    """KeystoreError if the keystore at `root` has nothing of a participant called `name`."""
    with disk_errors(root):
        try:
            (root / _layout.enclave_folder(name) / _layout.CERTIFICATE).lstat()
        except (FileNotFoundError, NotADirectoryError):
            instead = ""
            with suppress(FileError):  # that this one is not there is known all the same
                instead = meant(name, _layout.names_in(root))
            way = f"make it with `pqsec issue {name}`; `pqsec ca show` lists those there are"
            raise KeystoreError(
                f"there is no participant {name} in {root}",
                hint=f"{instead} If not, {way}" if instead else way,
            ) from None


def load_certificate(path: Path) -> Certificate:
    """The certificate in PEM file `path`; errors name the file."""
    with located(path):
        return Certificate.from_pem(read(path))


def load_revocation_list(path: Path) -> RevocationList:
    """The revocation list in PEM file `path`; errors name the file."""
    with located(path):
        return _revocation_list(read(path))


@lru_cache(maxsize=8)
def _revocation_list(data: bytes) -> RevocationList:
    """All participants of a keystore share one, which may be long."""
    return RevocationList.from_pem(data)


def _check_complete(folder: Path, name: str) -> None:
    """The six files that every stack reads; ROS 2 does not say which one it misses.

    Nor does it say that a link to a revocation list leads nowhere: it takes everybody.
    """
    needed = (
        _layout.KEY,
        _layout.PERMISSIONS,
        _layout.GOVERNANCE,
        _layout.IDENTITY_CA,
        _layout.PERMISSIONS_CA,
        *([_layout.LIST] if (folder / _layout.LIST).is_symlink() else []),
    )
    missing = [name for name in needed if not exists(folder / name)]
    lost = [str((folder / name).readlink()) for name in missing if (folder / name).is_symlink()]
    if missing == [_layout.KEY] and exists(folder / _layout.REQUEST):
        raise KeystoreError(
            f"{folder} lacks {_layout.KEY}: its keys are on its robot",
            hint="what is here can be checked without them: `pqsec check`, `pqsec explain`",
        )
    if missing:
        hint = f"restore {', '.join(lost)}, which all participants share" if lost else None
        if _layout.PERMISSIONS in missing:
            hint = hint or f"put it back, or say what it may do: pqsec issue {name} --force ..."
        raise KeystoreError(f"{folder} lacks {', '.join(missing)}", hint=hint)


def _key(path: Path, passphrase: bytes | None) -> PrivateKey:
    with located(path):
        return load_private_key(read(path), passphrase)
