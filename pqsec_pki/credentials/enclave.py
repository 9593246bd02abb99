"""An enclave's files as one value: read once, from bytes; nothing of it is verified here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

from pqsec_pki.algorithms import PrivateKey, load_private_key
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials._pem_files import only_certificate
from pqsec_pki.credentials.anchors import TrustAnchors
from pqsec_pki.credentials.names import (
    ALT_KEY,
    CERTIFICATE,
    GOVERNANCE,
    KEY,
    NEEDED,
    PERMISSIONS,
)
from pqsec_pki.errors import KeystoreError, PqsecError, located
from pqsec_pki.problems import Code


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Credentials:
    """What one participant runs with, as its files say."""

    name: str
    certificate: Certificate
    private_key: PrivateKey | None = field(default=None, repr=False)
    """None where the keys are on the participant's robot alone."""
    alternative_key: PrivateKey | None = field(default=None, repr=False)
    anchors: TrustAnchors
    permissions: bytes = field(repr=False)
    """The signed permissions document, S/MIME."""
    governance: bytes = field(repr=False)
    """The signed governance document, S/MIME."""

    @classmethod
    def of(
        cls,
        name: str,
        files: Mapping[str, bytes],
        passphrase: bytes | None = None,
        *,
        folder: object = None,
    ) -> Self:
        """From the files of the enclave `name`, by their names in `names.FILES`.

        KeystoreError if one that every participant needs is missing, MalformedError for one
        that cannot be read, PassphraseError for an encrypted key without `passphrase`; they
        name the file in `folder`, if that is told.
        """
        where = str(folder or name)
        missing = [each for each in NEEDED if each not in files]
        if missing:
            raise KeystoreError(f"{where} lacks {', '.join(missing)}", code=Code.FILE_MISSING)
        return cls(
            name=name,
            certificate=only_certificate(files[CERTIFICATE], f"{where}/{CERTIFICATE}"),
            private_key=_key(files, KEY, passphrase, where),
            alternative_key=_key(files, ALT_KEY, passphrase, where),
            anchors=TrustAnchors.of(files, folder=where),
            permissions=files[PERMISSIONS],
            governance=files[GOVERNANCE],
        )

    @property
    def key(self) -> PrivateKey:
        """KeystoreError where the keys are on the participant's robot alone."""
        if self.private_key is None:
            raise KeystoreError(f"the keys of {self.name} are not here but on its robot")
        return self.private_key

    @property
    def identity_ca(self) -> Certificate:
        """The CA that its own certificate is of."""
        return self.anchors.identity_ca

    @property
    def permissions_ca(self) -> Certificate:
        """The signer of its documents."""
        return self.anchors.permissions_ca

    @property
    def countersigner(self) -> Certificate | None:
        """Who also signs its documents, where they are signed twice."""
        return self.anchors.countersigner

    @property
    def revocation_list(self) -> RevocationList | None:
        """The identity CA's, once it has revoked a certificate."""
        return self.anchors.revocation_list


def alternative_spki(certificate: Certificate) -> bytes | None:
    """DER of the certificate's alternative key, if it has one that can be read."""
    try:
        second = certificate.alternative_key
    except PqsecError:  # which the chain check tells of
        return None
    return second.spki if second else None


def _key(
    files: Mapping[str, bytes], name: str, passphrase: bytes | None, where: str
) -> PrivateKey | None:
    if name not in files:
        return None
    with located(f"{where}/{name}"):
        return load_private_key(files[name], passphrase)
