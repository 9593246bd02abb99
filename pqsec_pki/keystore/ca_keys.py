"""The files of the CAs' private keys: their names, algorithms and content."""

from collections.abc import Collection
from enum import StrEnum
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.algorithms import PrivateKey, Profile, SignatureAlgorithm
from pqsec_pki.errors import FileError, KeystoreError, MissingError, PassphraseError, located
from pqsec_pki.keystore import layout
from pqsec_pki.tokens import Pin, is_reference, key_in, stored_pin

_KEYLESS = (
    "status, log, check, explain, who-may, diff, verify-handshake, bundle and export need no CA key"
)


class SigningCa(StrEnum):
    """A CA whose private keys a command needs."""

    IDENTITY = "identity CA"
    PERMISSIONS = "permissions CA"
    """Includes its countersigner."""

    @property
    def label(self) -> str:
        """The name in options and files: identity or permissions."""
        return self.name.lower()

    @property
    def key_files(self) -> tuple[str, str]:
        """The names of the files of its keys; the second only if it has a second key."""
        if self is SigningCa.IDENTITY:
            return layout.IDENTITY_KEY, layout.IDENTITY_ALT_KEY
        return layout.PERMISSIONS_KEY, layout.PERMISSIONS_ALT_KEY


def key_algorithms(profile: Profile) -> dict[str, SignatureAlgorithm]:
    """The names of the files of CA keys -> the algorithms of their keys."""
    found = {
        layout.IDENTITY_KEY: profile.identity_key,
        layout.PERMISSIONS_KEY: profile.permissions_key,
    }
    if second := profile.alternative_key:
        found |= {layout.IDENTITY_ALT_KEY: second, layout.PERMISSIONS_ALT_KEY: second}
    return found


def ca_key_files(profile: Profile, cas: Collection[SigningCa] = ()) -> list[str]:
    """The names of the files of the keys of `cas`, or of all CAs."""
    wanted = {name for each in cas or SigningCa for name in each.key_files}
    return [name for name in key_algorithms(profile) if name in wanted]


def read_ca_key(path: Path) -> bytes:
    """The file of a CA's private key; KeystoreError if it is missing, FileError if unreadable."""
    try:
        return read(path)
    except MissingError:
        raise KeystoreError(
            "the CA's private key is not here",
            hint="restore the key for this command. If another machine has it, use `pqsec"
            " sign-request`; if each CA has its own machine, `pqsec issue --certificate-only` and"
            f" `pqsec permit`. {_KEYLESS}",
            where=path,
        ) from None
    except FileError as error:
        error.hint = error.hint or f"signing needs read access to {path.parent}. {_KEYLESS}"
        raise


def load_ca_key(path: Path, passphrase: bytes | None, pin: Pin | None = None) -> PrivateKey:
    """The private key in the file `path`, or in the token that it refers to.

    PassphraseError if `passphrase` or the PIN is wrong. Errors as of `read_ca_key` and `find_key`.
    """
    data = read_ca_key(path)
    try:
        with located(path):
            return key_in(data, passphrase, pin or stored_pin)
    except PassphraseError as error:
        if not is_reference(data):
            error.hint = "give the CA passphrase: --passphrase-file, or at the prompt"
        raise
