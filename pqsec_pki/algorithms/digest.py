"""Digests that CMS signers may name, with their S/MIME micalg."""

import hashlib

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import UnknownAlgorithmError


@dataclass(frozen=True, slots=True)
class Digest:
    """A hash function in CMS (RFC 5754, RFC 8702, RFC 9882)."""

    name: str
    oid: str
    micalg: str
    xof_size: int | None = None
    """Bytes of output, if the function has no fixed length."""

    def of(self, data: bytes) -> bytes:
        """The digest of `data`."""
        if self.xof_size is None:
            return hashlib.new(self.name, data).digest()
        return hashlib.new(self.name, data).digest(self.xof_size)  # type: ignore[call-arg]  # XOF


DIGESTS = tuple(
    Digest(name, f"2.16.840.1.101.3.4.2.{arc}", micalg, size)
    for name, arc, micalg, size in (
        ("sha256", 1, "sha-256", None),
        ("sha384", 2, "sha-384", None),
        ("sha512", 3, "sha-512", None),
        ("sha3_256", 8, "sha3-256", None),
        ("sha3_384", 9, "sha3-384", None),
        ("sha3_512", 10, "sha3-512", None),
        ("shake_128", 11, "shake128", 32),
        ("shake_256", 12, "shake256", 64),
    )
)
SHA256, SHA384, SHA512, SHA3_256, SHA3_384, SHA3_512, SHAKE128, SHAKE256 = DIGESTS
_BY_OID = {digest.oid: digest for digest in DIGESTS}
BROKEN_DIGESTS = {
    "1.3.14.3.2.26": "SHA-1",
    "1.2.840.113549.2.5": "MD5",
    "1.2.840.113549.2.2": "MD2",
}


def digest_of(oid: str) -> Digest:
    """The digest with that dotted OID; UnknownAlgorithmError for SHA-1, MD5 and others."""
    try:
        return _BY_OID[oid]
    except KeyError:
        if oid in BROKEN_DIGESTS:
            raise UnknownAlgorithmError(f"digest {BROKEN_DIGESTS[oid]} is no longer safe") from None
        raise UnknownAlgorithmError(f"digest {oid} is not known here") from None
