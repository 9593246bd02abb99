"""An enclave's files as one value, decoded from bytes; nothing is verified here."""

from collections.abc import Mapping
from dataclasses import field
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials._pem_files import only_certificate
from pqsec_pki.credentials.anchors import TrustAnchors
from pqsec_pki.credentials.names import (
    ALT_KEY,
    CERTIFICATE,
    GOVERNANCE,
    KEY,
    KEYS,
    NEEDED,
    PERMISSIONS,
)
from pqsec_pki.errors import KeystoreError, PqsecError, located
from pqsec_pki.problems import Code
from pqsec_pki.tokens import Pin, is_reference, key_in, stored_pin


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Credentials:
    """The credentials of one participant, as in its files."""

    name: str
    certificate: Certificate
    private_key: PrivateKey | None = field(default=None, repr=False)
    """None if the keys are only on the participant's robot, or were not asked for in a token."""
    alternative_key: PrivateKey | None = field(default=None, repr=False)
    anchors: TrustAnchors
    permissions: bytes = field(repr=False)
    """The signed permissions document, S/MIME."""
    governance: bytes = field(repr=False)
    """The signed governance document, S/MIME."""

    @classmethod
    def of(  # noqa: PLR0913 -- the files of an enclave, by name, and how to read them
        cls,
        name: str,
        files: Mapping[str, bytes],
        passphrase: bytes | None = None,
        *,
        pin: Pin | None = None,
        folder: object = None,
        anchors: TrustAnchors | None = None,
    ) -> Self:
        """The credentials in the files of the enclave `name`, by their names in `names.FILES`.

        KeystoreError if a required file is missing, MalformedError for a file that cannot be
        decoded, PassphraseError for an encrypted key without `passphrase`; the errors name
        the file in `folder`, if given. `anchors` are those of the files, if they were read before.
        Keys in tokens are asked for only with `pin`, which gives PINs; errors as of `find_key`.
        """
        where = str(folder or name)
        missing = [each for each in NEEDED if each not in files]
        if missing:
            raise KeystoreError(f"{where} lacks {', '.join(missing)}", code=Code.FILE_MISSING)
        keys = {each: files[each] for each in KEYS if each in files}
        if pin is None and any(map(is_reference, keys.values())):
            keys = {}  # one key alone would look like a missing other one
        return cls(
            name=name,
            certificate=only_certificate(files[CERTIFICATE], f"{where}/{CERTIFICATE}"),
            private_key=_key(keys, KEY, passphrase, pin, where),
            alternative_key=_key(keys, ALT_KEY, passphrase, pin, where),
            anchors=anchors or TrustAnchors.of(files, folder=where),
            permissions=files[PERMISSIONS],
            governance=files[GOVERNANCE],
        )

    @property
    def key(self) -> PrivateKey:
        """The private key; KeystoreError if the keys are only on the participant's robot."""
        if self.private_key is None:
            raise KeystoreError(f"the keys of {self.name} are not here but on its robot")
        return self.private_key

    @property
    def identity_ca(self) -> Certificate:
        """The CA that issued its own certificate."""
        return self.anchors.identity_ca

    @property
    def permissions_ca(self) -> Certificate:
        """The signer of its documents."""
        return self.anchors.permissions_ca

    @property
    def countersigner(self) -> Certificate | None:
        """The second signer of its documents, if they are signed twice."""
        return self.anchors.countersigner

    @property
    def revocation_list(self) -> RevocationList | None:
        """The identity CA's revocation list, if there is one."""
        return self.anchors.revocation_list


def alternative_spki(certificate: Certificate) -> bytes | None:
    """DER of the certificate's alternative key, if it has one that can be read."""
    try:
        second = certificate.alternative_key
    except PqsecError:  # the chain check reports it
        return None
    return second.spki if second else None


def _key(
    files: Mapping[str, bytes], name: str, passphrase: bytes | None, pin: Pin | None, where: str
) -> PrivateKey | None:
    if name not in files:
        return None
    with located(f"{where}/{name}"):
        return key_in(files[name], passphrase, pin or stored_pin)
