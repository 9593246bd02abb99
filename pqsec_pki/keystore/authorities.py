"""The CAs of a keystore with their private keys, for issuing and signing."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Self

from pqsec_pki._files import read
from pqsec_pki.algorithms import (
    PrivateKey,
    Profile,
    PublicKey,
    load_private_key,
    private_key_pem,
)
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.errors import (
    FileError,
    KeystoreError,
    MissingError,
    PassphraseError,
    located,
)
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._entries import certificate_entry
from pqsec_pki.keystore._transaction import StagedFolder
from pqsec_pki.keystore.participant import load_first_certificate
from pqsec_pki.smime import Signer, sign

_KEYLESS = (
    "status, log, check, explain, who-may, diff, verify-handshake, bundle and export need no CA key"
)


@dataclass(frozen=True, slots=True, eq=False)
class Authorities:
    """The identity CA, the permissions CA, and the permissions CA's countersigner.

    The two CAs always have different keys: with one CA for both roles, a participant's key
    could sign permissions (CVE-2023-24010).
    """

    identity: Authority
    permissions: Authority
    countersigner: Authority | None
    """The ML-DSA half of the permissions CA. It has its own certificate, which documents need
    not carry: they are sent in every handshake."""
    embed_certificate: bool

    @classmethod
    def create(cls, profile: Profile, name: str, *, now: datetime, validity: timedelta) -> Self:
        """Create the profile's CAs, named `name` Identity CA and `name` Permissions CA."""
        second = profile.alternative_key
        signing = f"{name} Permissions CA".strip()
        return cls(
            identity=Authority.create(
                f"{name} Identity CA".strip(),
                profile.identity_key,
                alternative=second,
                now=now,
                validity=validity,
            ),
            permissions=Authority.create(
                signing, profile.permissions_key, now=now, validity=validity
            ),
            countersigner=Authority.create(
                f"{signing} {second.name}",
                second,
                now=now,
                validity=validity,
            )
            if second
            else None,
            embed_certificate=profile.runs_in_stock,
        )

    def sign(self, document: bytes, *, now: datetime, embed_certificate: bool = False) -> bytes:
        """The S/MIME file of a document; KeystoreError if a signer has expired."""
        counter = self.countersigner
        for each in filter(None, (self.permissions, counter)):
            end = each.certificate.not_after
            if now > end:
                name = each.certificate.subject_name
                raise KeystoreError(
                    f"{name} expired on {end:%Y-%m-%d}: it can no longer sign",
                    hint="replace the CAs with `pqsec ca rotate`, or correct the clock",
                )
        return sign(
            document,
            Signer(self.permissions.certificate, self.permissions.key),
            countersigner=Signer(counter.certificate, counter.key) if counter else None,
            embed_certificate=self.embed_certificate or embed_certificate,
            now=now,
        )

    def write(
        self,
        public: StagedFolder,
        private: StagedFolder,
        passphrase: bytes | None,
        *,
        trusted: Certificate | None = None,
    ) -> None:
        """Stage the certificates and, encrypted under `passphrase`, the keys.

        `trusted` is another identity CA that participants trust; it is added to the file.
        """
        for name, certificate in _certificates(self):
            second = trusted.pem if trusted and name == layout.IDENTITY_CA else b""
            public.public(name, certificate.pem + second)
        self.write_keys(private, passphrase)

    def write_keys(self, private: StagedFolder, passphrase: bytes | None) -> None:
        """Stage the keys, encrypted under `passphrase`; not encrypted for None."""
        keys = list(_keys(self))
        # Each encryption takes 600,000 hashes, and releases the interpreter lock.
        with ThreadPoolExecutor() as pool:
            pems = pool.map(lambda item: private_key_pem(item[1], passphrase), keys)
            for (name, _), pem in zip(keys, pems, strict=True):
                private.private(name, pem)

    def refuse_outdated(self, root: Path) -> None:
        """KeystoreError if the CAs of the keystore at `root` have been replaced.

        Call it while the keystore is locked.
        """
        for name, certificate in _certificates(self):
            if load_first_certificate(root / layout.PUBLIC / name).der != certificate.der:
                raise KeystoreError(
                    f"{certificate.subject_name} has been replaced by another CA meanwhile",
                    hint="run the command again",
                )

    def entries(self, now: datetime) -> Iterator[Entry]:
        """The CAs' entries for the ledger."""
        for name, certificate in _certificates(self):
            kind = "identity-ca" if name == layout.IDENTITY_CA else "permissions-ca"
            yield certificate_entry(kind, certificate.subject_name, certificate, now)


def unlock(root: Path, profile: Profile, passphrase: bytes | None) -> Authorities:
    """The CAs of the keystore at `root`.

    KeystoreError if a file is missing or a key does not fit its certificate,
    PassphraseError if the keys are encrypted and `passphrase` is missing or wrong.
    """
    names = [layout.IDENTITY_KEY, layout.PERMISSIONS_KEY]
    if profile.alternative_key:
        names += [layout.IDENTITY_ALT_KEY, layout.PERMISSIONS_ALT_KEY]
    with ThreadPoolExecutor() as pool:
        loaded = pool.map(lambda n: load_ca_key(root / layout.PRIVATE / n, passphrase), names)
        keys = dict(zip(names, loaded, strict=True))
    public = root / layout.PUBLIC
    counter_key = keys.get(layout.PERMISSIONS_ALT_KEY)
    authorities = Authorities(
        identity=Authority(
            load_first_certificate(public / layout.IDENTITY_CA),
            keys[layout.IDENTITY_KEY],
            keys.get(layout.IDENTITY_ALT_KEY),
        ),
        permissions=Authority(
            load_first_certificate(public / layout.PERMISSIONS_CA), keys[layout.PERMISSIONS_KEY]
        ),
        countersigner=Authority(
            load_first_certificate(public / layout.PERMISSIONS_ALT_CA), counter_key
        )
        if counter_key
        else None,
        embed_certificate=profile.runs_in_stock,
    )
    _check_pairs(authorities)
    return authorities


def _certificates(authorities: Authorities) -> Iterator[tuple[str, Certificate]]:
    yield layout.IDENTITY_CA, authorities.identity.certificate
    yield layout.PERMISSIONS_CA, authorities.permissions.certificate
    if authorities.countersigner:
        yield layout.PERMISSIONS_ALT_CA, authorities.countersigner.certificate


def _keys(authorities: Authorities) -> Iterator[tuple[str, PrivateKey]]:
    yield layout.IDENTITY_KEY, authorities.identity.key
    yield layout.PERMISSIONS_KEY, authorities.permissions.key
    if authorities.identity.alternative_key:
        yield layout.IDENTITY_ALT_KEY, authorities.identity.alternative_key
    if authorities.countersigner:
        yield layout.PERMISSIONS_ALT_KEY, authorities.countersigner.key


def read_ca_key(path: Path) -> bytes:
    """The file of a CA's private key; KeystoreError if it is missing, FileError if unreadable."""
    try:
        return read(path)
    except MissingError:
        raise KeystoreError(
            "the CA's private key is not here",
            hint="put it back for this command; or, if it is kept on an offline machine, sign"
            f" requests there: `pqsec sign-request`. {_KEYLESS}",
            where=path,
        ) from None
    except FileError as error:
        error.hint = error.hint or f"signing needs read access to {path.parent}. {_KEYLESS}"
        raise


def load_ca_key(path: Path, passphrase: bytes | None) -> PrivateKey:
    """The private key in the file `path`; PassphraseError if `passphrase` is wrong.

    Errors as of `read_ca_key`.
    """
    try:
        with located(path):
            return load_private_key(read_ca_key(path), passphrase)
    except PassphraseError as error:
        error.hint = "give the CA passphrase: --passphrase-file, or at the prompt"
        raise


def _check_pairs(authorities: Authorities) -> None:
    """KeystoreError if the CAs share a key, or a key does not match its certificate."""
    if authorities.identity.certificate.spki == authorities.permissions.certificate.spki:
        raise KeystoreError(
            "the identity CA and the permissions CA have the same key (CVE-2023-24010)",
            hint="replace them by two distinct CAs and reissue everything: `pqsec ca rotate`",
        )
    for authority in (authorities.identity, authorities.permissions, authorities.countersigner):
        if authority:
            check_pair(authority)


def check_pair(authority: Authority) -> None:
    """KeystoreError if a private key does not match its certificate."""
    certificate = authority.certificate
    held: list[tuple[PrivateKey, PublicKey | None]] = [(authority.key, certificate.public_key)]
    if authority.alternative_key:
        held.append((authority.alternative_key, certificate.alternative_key))
    for key, known in held:
        if known is None or key.public_key.spki != known.spki:
            raise KeystoreError(
                f"{certificate.subject_name}: a private key does not match the certificate"
            )
