"""The class of signature algorithms: a row with its operations, and its keys.

A handle is the key object of `cryptography` (or a pair of them); only rows use it.
"""

from abc import ABC, abstractmethod
from dataclasses import field
from typing import Any

from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from pqsec_pki._asn1 import Oid, SubjectPublicKeyInfo, encode, whole_bytes
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._table import Family, Registered
from pqsec_pki.algorithms.digest import Digest
from pqsec_pki.errors import (
    MalformedError,
    PqsecError,
    UsageError,
    VerificationError,
    library_call,
    words_of,
)

_BROKEN = {
    encode(Oid(oid)): digest
    for oid, digest in (
        ("1.2.840.113549.1.1.2", "MD2"),
        ("1.2.840.113549.1.1.4", "MD5"),
        ("1.2.840.113549.1.1.5", "SHA-1"),
        ("1.3.14.3.2.29", "SHA-1"),
        ("1.2.840.10045.4.1", "SHA-1"),
    )
}
"""Signature algorithms, by their identifier in DER, that are refused for their digest."""


def broken_digest(identifier: bytes) -> str | None:
    """The name of the digest if it is broken, such as SHA-1, of a DER AlgorithmIdentifier."""
    return next((name for begin, name in _BROKEN.items() if begin in identifier), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignatureAlgorithm(ABC):
    """One signature algorithm: its names, its sizes and its operations."""

    name: str
    """Its name on the command line and in the keystore."""
    aliases: tuple[str, ...] = ()
    family: Family
    level: int
    """NIST security category; 0 if a quantum computer breaks it."""
    registered: Registered = field(repr=False)
    standard: str
    runs_in: str
    """The stock DDS stacks that accept identities with this algorithm."""
    wire_name: str
    """Its name in c.dsign_algo (DDS-Security 1.1, 9.3.2.5)."""
    token_name: str
    """Its name in dds.cert.algo and dds.ca.algo of an IdentityToken."""
    key_oid: str
    """The OID of its keys in SubjectPublicKeyInfo and PKCS#8."""
    identifier: bytes = field(repr=False)
    """DER AlgorithmIdentifier that signatures are marked with."""
    digest: Digest
    """The digest of the content that pqsec uses in CMS."""
    cms_digests: frozenset[Digest] = field(repr=False)
    """The digests that are accepted in CMS with this algorithm; all others are refused."""
    public_key_size: int
    """Bytes in the BIT STRING of SubjectPublicKeyInfo."""
    signature_size: int
    """Bytes, at most."""

    @property
    def parts(self) -> "tuple[SignatureAlgorithm, ...]":
        """The algorithms that it combines; none if it is not a combination."""
        return ()

    def to_json(self) -> dict[str, object]:
        """Its names and sizes, for JSON."""
        return {
            "name": self.name,
            "aliases": self.aliases,
            "family": self.family,
            "level": self.level,
            "public_key_bytes": self.public_key_size,
            "signature_bytes": self.signature_size,
            "standard": self.standard,
            "identities_run_in": self.runs_in,
        }

    def generate(self) -> "PrivateKey":
        """A new key."""
        return self.private_key(self.generate_handle())

    def private_key(self, handle: Any) -> "PrivateKey":
        """`handle`, a private key of this kind, as a value."""
        return PrivateKey(self, self.public_key(self._public(handle)), handle)

    def public_key(self, handle: Any) -> "PublicKey":
        """`handle`, a public key of this kind, as a value."""
        return PublicKey(self, self._spki(handle), handle)

    @abstractmethod
    def matches(self, handle: Any) -> bool:
        """Whether `handle` is a public key of this kind."""

    @abstractmethod
    def raw_public(self, handle: Any) -> bytes:
        """The content of the public key's BIT STRING: `public_key_size` bytes."""

    @abstractmethod
    def raw_private(self, handle: Any) -> bytes:
        """The private key as in a composite key (composite draft, section 4)."""

    @abstractmethod
    def load_raw_public(self, data: bytes) -> Any:
        """The inverse of raw_public; ValueError if `data` is not such a key."""

    @abstractmethod
    def load_raw_private(self, data: bytes) -> Any:
        """The inverse of raw_private; ValueError if `data` is not such a key."""

    def load_spki(self, info: SubjectPublicKeyInfo) -> Any:
        """The handle of a SubjectPublicKeyInfo with `key_oid`; MalformedError if it is not one."""
        if info.algorithm.parameters is not None:
            raise MalformedError(f"{self.name} keys have no parameters")
        key = whole_bytes(info.subject_public_key, "the public key")
        words = f"not a {self.name} public key"
        with library_call(lambda error: MalformedError(f"{words}: {words_of(error)}")):
            return self.load_raw_public(key)

    @abstractmethod
    def sign(self, handle: Any, data: bytes) -> bytes:
        """A signature as in certificates and CMS."""

    @abstractmethod
    def check(self, handle: Any, signature: bytes, data: bytes, identifier: bytes) -> None:
        """InvalidSignature or ValueError unless `signature` is valid under `identifier`."""

    def accepts(self, identifier: bytes) -> bool:
        """Whether DER `identifier` is an algorithm of signatures by such a key."""
        return identifier == self.identifier

    def cms_identifier(self, identifier: bytes, digest: Digest) -> bytes:
        """The full identifier for the `identifier` and `digest` of a CMS signer."""
        del digest
        return identifier

    def sign_handshake(self, handle: Any, data: bytes) -> bytes:
        """A signature as in handshake messages."""
        return self.sign(handle, data)

    def refuse_own_handshakes(self) -> None:
        """UsageError if its handshakes are signed in another way than its certificates.

        A key in a token signs only as in certificates.
        """
        if type(self).sign_handshake is not SignatureAlgorithm.sign_handshake:
            raise UsageError(
                f"a token cannot sign handshakes with {self.name} keys: they need RSA-PSS",
                hint="choose a participant's key of another kind, such as ecdsa-p256",
            )

    def check_handshake(self, handle: Any, signature: bytes, data: bytes) -> None:
        """InvalidSignature or ValueError unless the handshake signature is valid."""
        self.check(handle, signature, data, self.identifier)

    @abstractmethod
    def generate_handle(self) -> Any: ...

    def _public(self, handle: Any) -> Any:
        return handle.public_key()

    def _spki(self, handle: Any) -> bytes:
        spki: bytes = handle.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
        return spki

    def pkcs8(self, handle: Any) -> bytes:
        """DER PrivateKeyInfo, unencrypted; post-quantum keys as their seed (RFC 9881 6)."""
        der: bytes = handle.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
        return der


@dataclass(frozen=True, slots=True, eq=False)
class PublicKey:
    """A public key and its algorithm."""

    algorithm: SignatureAlgorithm
    spki: bytes
    """DER SubjectPublicKeyInfo."""
    handle: Any = field(repr=False)

    @property
    def raw(self) -> bytes:
        """The bytes inside the BIT STRING of `spki`."""
        return self.algorithm.raw_public(self.handle)

    @property
    def parts(self) -> "tuple[PublicKey, ...]":
        """The keys that a composite key consists of; none for a plain one."""
        rows = self.algorithm.parts
        handles = self.handle if rows else ()
        return tuple(row.public_key(each) for row, each in zip(rows, handles, strict=True))

    def verify(self, signature: bytes, data: bytes, identifier: bytes | None = None) -> None:
        """Return if `signature` over `data` is this key's; VerificationError if not.

        `identifier` is the DER AlgorithmIdentifier of the signature, if it has one: one that
        does not match the key is refused before any arithmetic.
        """
        marked = self.algorithm.identifier if identifier is None else identifier
        if not self.algorithm.accepts(marked):
            if digest := broken_digest(marked):
                raise VerificationError(
                    f"the signature is made with {digest}, which is no longer safe"
                )
            raise VerificationError(
                f"the signature is marked with an algorithm that does not fit"
                f" the signer's {self.algorithm.name} key"
            )
        with library_call(lambda _: VerificationError(f"bad {self.algorithm.name} signature")):
            self.algorithm.check(self.handle, signature, data, marked)

    def verify_handshake(self, signature: bytes, data: bytes) -> None:
        """Like `verify`, for a signature in a handshake message (DDS-Security 1.1, 9.3.2.5)."""
        with library_call(lambda _: VerificationError(f"bad {self.algorithm.wire_name} signature")):
            self.algorithm.check_handshake(self.handle, signature, data)


@dataclass(frozen=True, slots=True, eq=False)
class PrivateKey:
    """A private key and its algorithm. Its repr shows no key."""

    algorithm: SignatureAlgorithm
    public_key: PublicKey
    handle: Any = field(repr=False)

    @property
    def raw(self) -> bytes:
        """The key as in a composite private key."""
        return self.algorithm.raw_private(self.handle)

    @property
    def pkcs8(self) -> bytes:
        """DER PrivateKeyInfo, unencrypted."""
        return self.algorithm.pkcs8(self.handle)

    def sign(self, data: bytes) -> bytes:
        """A signature over `data` as in certificates and CMS."""
        return self.algorithm.sign(self.handle, data)

    def sign_handshake(self, data: bytes) -> bytes:
        """A signature over `data` as in handshake messages."""
        return self.algorithm.sign_handshake(self.handle, data)


@dataclass(frozen=True, slots=True, eq=False)
class ExternalKey(PrivateKey):
    """A private key that somebody else holds and does not give away: a token, or a key service.

    The handle is the holder. It has `sign(data)`, which gives a signature as in certificates.
    """

    uri: str
    """The URI of the key."""

    @property
    def raw(self) -> bytes:
        """PqsecError: it cannot be had."""
        raise PqsecError(f"the private key {self.uri} does not leave the place that holds it")

    @property
    def pkcs8(self) -> bytes:
        """PqsecError: it cannot be had."""
        return self.raw

    def sign(self, data: bytes) -> bytes:
        """A signature over `data`; PqsecError if the signer's is not one by this key."""
        signature: bytes = self.handle.sign(data)
        try:
            self.public_key.verify(signature, data)
        except VerificationError as error:
            raise PqsecError(
                f"the holder of the private key {self.uri} gave another key's signature",
                hint="its public and its private key object may have got the same name",
            ) from error
        return signature

    def sign_handshake(self, data: bytes) -> bytes:
        """A signature over `data` as in handshake messages; UsageError if that is another kind."""
        self.algorithm.refuse_own_handshakes()
        return self.sign(data)
