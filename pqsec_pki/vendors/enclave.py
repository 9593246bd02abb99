"""The folder of one participant, which a stack's configuration names."""

from collections.abc import Collection
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki.algorithms import Profile, is_encrypted
from pqsec_pki.credentials import (
    CERTIFICATE,
    FILES,
    GOVERNANCE,
    IDENTITY_CA,
    KEY,
    KEYS,
    PERMISSIONS,
    PERMISSIONS_CA,
    REQUEST,
    REVOCATION_LIST,
    SIX,
    Credentials,
    verify_credentials,
)
from pqsec_pki.errors import KeystoreError, PqsecError, UsageError, located, problems_of, shown
from pqsec_pki.keystore import Keystore, regular_name
from pqsec_pki.problems import Code, Problem
from pqsec_pki.tokens import is_reference, uri_in, usable
from pqsec_pki.vendors.exports import PASSWORD_VARIABLE, Options

_INSTALLED = "/etc/dds/current/enclaves"


@dataclass(frozen=True, slots=True, kw_only=True)
class StackEnclave:
    """The files of one participant."""

    name: str
    """Its enclave path, such as /fleet/robot1."""
    folder: Path
    """Absolute."""
    keystore: Path
    """The keystore's folder, absolute."""
    profile: Profile
    key_is_encrypted: bool
    key_is_elsewhere: bool
    """Whether the participant generated its keys, so that only its robot has them."""
    key_uri: str | None
    """The place of the private key, if it is in a token."""
    has_crl: bool
    """Whether there is a revocation list beside the certificate."""
    has_large_handshake: bool
    """Whether its messages contain ML-DSA signatures, and so are three times as large."""
    at: PurePosixPath
    """Where the folder will be when a stack reads it; absolute."""

    @classmethod
    def find(cls, keystore: Keystore, name: str, at: PurePosixPath | None = None) -> Self:
        """The enclave of the participant called `name`.

        KeystoreError if there is none or one of the six files is missing, UsageError for an
        invalid name or a relative `at`.
        """
        keystore.refuse_unknown(name)
        name, profile, root = regular_name(name), keystore.profile, keystore.folder.absolute()
        folder = root / f"enclaves{name}"
        where = _absolute(at or PurePosixPath(folder))
        elsewhere = at is not None and exists(folder / REQUEST)
        _refuse_incomplete(folder, name, without={KEY} if elsewhere else set())
        has_crl = exists(folder / REVOCATION_LIST)
        with located(folder / KEY):
            key = b"" if elsewhere else read(folder / KEY)
            key_uri = usable(uri_in(key)) if is_reference(key) else None
        return cls(
            name=name,
            folder=folder,
            keystore=root,
            profile=profile,
            key_is_encrypted=is_encrypted(key),
            key_is_elsewhere=elsewhere,
            key_uri=key_uri,
            has_crl=has_crl,
            has_large_handshake=profile.alternative_key is not None or not profile.runs_in_stock,
            at=where,
        )

    def refusals(self, now: datetime) -> tuple[Problem, ...]:
        """Why its credentials cannot be trusted at `now` (room `credentials`); empty if they can.

        A key that is encrypted, on its robot or in a token is not checked. FileError for a file
        that cannot be read.
        """
        names = [each for each in FILES if not (self.key_is_encrypted and each in KEYS)]
        files = {each: read(self.folder / each) for each in names if exists(self.folder / each)}
        try:
            verify_credentials(Credentials.of(self.name, files), now=now)
        except PqsecError as error:
            return problems_of(error)
        return ()

    def uri(self, file: str) -> str:
        """The future path of `file` as file:///, the form of a URI that all stacks accept.

        Nothing is escaped: the stacks use what follows file:// as the path, byte for byte.
        """
        return f"file://{self.at / file}"


def _absolute(where: PurePosixPath) -> PurePosixPath:
    if not where.is_absolute():
        raise UsageError(
            f"{shown(str(where))}: not an absolute path", hint="stacks need absolute paths"
        )
    return where


def _refuse_incomplete(folder: Path, name: str, *, without: Collection[str]) -> None:
    missing = [file for file in SIX if file not in without and not exists(folder / file)]
    if missing:
        raise KeystoreError(
            f"{folder} lacks {', '.join(missing)}",
            code=Code.FILE_MISSING,
            hint=f"its keys are on its robot: give their place, as in --at {_INSTALLED}{name}"
            if missing == [KEY] and exists(folder / REQUEST)
            else "issue the participant again, or restore what links lead to",
        )


def password_note(enclave: StackEnclave, options: Options) -> tuple[str, ...]:
    """A note if the key is encrypted and the stack reads its passphrase from the environment."""
    if not enclave.key_is_encrypted or options.password is not None:
        return ()
    return (f"the key is encrypted: set {PASSWORD_VARIABLE} to its passphrase",)


def standard_properties(enclave: StackEnclave) -> dict[str, str]:
    """The properties of a participant by their names in DDS-Security 1.1 (9.3.1, 9.4.1)."""
    return {
        "dds.sec.auth.identity_ca": enclave.uri(IDENTITY_CA),
        "dds.sec.auth.identity_certificate": enclave.uri(CERTIFICATE),
        "dds.sec.auth.private_key": enclave.uri(KEY),
        "dds.sec.access.permissions_ca": enclave.uri(PERMISSIONS_CA),
        "dds.sec.access.governance": enclave.uri(GOVERNANCE),
        "dds.sec.access.permissions": enclave.uri(PERMISSIONS),
    }
