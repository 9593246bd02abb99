"""ECDSA, RSA and EdDSA: the algorithms of today's stacks, and components of composites."""

from dataclasses import field
from functools import cache
from typing import Any

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed448, ed25519, padding, rsa
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_der_private_key,
    load_der_public_key,
)

from pqsec_pki._asn1 import ECPrivateKey, Oid, algorithm, encode
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._row import SignatureAlgorithm
from pqsec_pki.algorithms.digest import Digest

Hash = hashes.SHA256 | hashes.SHA384 | hashes.SHA512
_HASHES: dict[str, Hash] = {
    "sha256": hashes.SHA256(),
    "sha384": hashes.SHA384(),
    "sha512": hashes.SHA512(),
}


# RFC 5758 3.2: parameters absent. RFC 4055 5: parameters NULL.
ECDSA_WITH = {f"sha{n}": f"1.2.840.10045.4.3.{arc}" for n, arc in ((256, 2), (384, 3), (512, 4))}
RSA_WITH = {
    f"sha{n}": f"1.2.840.113549.1.1.{n_arc}" for n, n_arc in ((256, 11), (384, 12), (512, 13))
}
_ECDSA_DIGEST = {encode(algorithm(oid)): name for name, oid in ECDSA_WITH.items()}
_RSA_HASH = {encode(algorithm(oid, null=True)): _HASHES[name] for name, oid in RSA_WITH.items()}
_LONGEST_SALT, _ANY_SALT = (
    padding.PSS(padding.MGF1(hashes.SHA256()), salt)
    for salt in (padding.PSS.MAX_LENGTH, padding.PSS.AUTO)
)
_HASH_SALT = {
    name: padding.PSS(padding.MGF1(hash_), hash_.digest_size) for name, hash_ in _HASHES.items()
}
_RSA_ENCRYPTION = encode(algorithm("1.2.840.113549.1.1.1", null=True))


@cache
def _ecdsa(digest: str) -> ec.ECDSA:
    return ec.ECDSA(_HASHES[digest])


@dataclass(frozen=True, slots=True, kw_only=True)
class Ecdsa(SignatureAlgorithm):
    """ECDSA on one curve, with the hash of the curve's strength (FIPS 186-5)."""

    curve: ec.EllipticCurve = field(repr=False)
    curve_oid: str

    def matches(self, handle: Any) -> bool:
        return (
            isinstance(handle, ec.EllipticCurvePublicKey) and handle.curve.name == self.curve.name
        )

    def raw_public(self, handle: Any) -> bytes:
        point: bytes = handle.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)
        return point

    def load_raw_public(self, data: bytes) -> Any:
        if len(data) != self.public_key_size or data[0] != 4:  # noqa: PLR2004 -- SEC1: uncompressed
            raise ValueError("not an uncompressed point")
        return ec.EllipticCurvePublicKey.from_encoded_point(self.curve, data)

    def raw_private(self, handle: Any) -> bytes:
        """RFC 5915 with namedCurve and without publicKey."""
        number = handle.private_numbers().private_value
        size = (self.curve.key_size + 7) // 8
        return encode(
            ECPrivateKey(
                version=1,
                private_key=number.to_bytes(size, "big"),
                parameters=Oid(self.curve_oid),
                public_key=None,
            )
        )

    def load_raw_private(self, data: bytes) -> Any:
        key = load_der_private_key(data, None)
        if not self.matches(key.public_key()):
            raise ValueError("another curve")
        return key

    def sign(self, handle: Any, data: bytes) -> bytes:
        signature: bytes = handle.sign(data, _ecdsa(self.digest.name))
        return signature

    def accepts(self, identifier: bytes) -> bool:
        return identifier in _ECDSA_DIGEST

    def check(self, handle: Any, signature: bytes, data: bytes, identifier: bytes) -> None:
        handle.verify(signature, data, _ecdsa(_ECDSA_DIGEST[identifier]))

    def generate_handle(self) -> Any:
        return ec.generate_private_key(self.curve)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rsa(SignatureAlgorithm):
    """RSA of one size: PKCS#1 v1.5 in certificates and CMS, PSS in the handshake."""

    bits: int

    def matches(self, handle: Any) -> bool:
        return isinstance(handle, rsa.RSAPublicKey) and handle.key_size == self.bits

    def raw_public(self, handle: Any) -> bytes:
        der: bytes = handle.public_bytes(Encoding.DER, PublicFormat.PKCS1)
        return der

    def load_raw_public(self, data: bytes) -> Any:
        try:
            key = load_der_public_key(data)
        except UnsupportedAlgorithm:
            key = None
        # The library accepts SubjectPublicKeyInfo too; only PKCS#1 is allowed here.
        if not self.matches(key) or self.raw_public(key) != data:
            raise ValueError(f"not an RSA key of {self.bits} bits")
        return key

    def raw_private(self, handle: Any) -> bytes:
        der: bytes = handle.private_bytes(
            Encoding.DER, PrivateFormat.TraditionalOpenSSL, NoEncryption()
        )
        return der

    def load_raw_private(self, data: bytes) -> Any:
        key = load_der_private_key(data, None)
        if not self.matches(key.public_key()):
            raise ValueError(f"not an RSA key of {self.bits} bits")
        return key

    def sign(self, handle: Any, data: bytes) -> bytes:
        signature: bytes = handle.sign(data, padding.PKCS1v15(), _HASHES[self.digest.name])
        return signature

    def accepts(self, identifier: bytes) -> bool:
        return identifier in _RSA_HASH

    def check(self, handle: Any, signature: bytes, data: bytes, identifier: bytes) -> None:
        handle.verify(signature, data, padding.PKCS1v15(), _RSA_HASH[identifier])

    def cms_identifier(self, identifier: bytes, digest: Digest) -> bytes:
        """RFC 3370 3.2: rsaEncryption means RSA with the given digest."""
        if identifier != _RSA_ENCRYPTION or digest.name not in RSA_WITH:
            return identifier
        return encode(algorithm(RSA_WITH[digest.name], null=True))

    def sign_handshake(self, handle: Any, data: bytes) -> bytes:
        signature: bytes = handle.sign(data, _LONGEST_SALT, _HASHES["sha256"])
        return signature

    def check_handshake(self, handle: Any, signature: bytes, data: bytes) -> None:
        # Cyclone DDS and OpenDDS sign with the longest salt, Fast DDS with 32 bytes.
        handle.verify(signature, data, _ANY_SALT, _HASHES["sha256"])

    def generate_handle(self) -> Any:
        return rsa.generate_private_key(65537, self.bits)


@dataclass(frozen=True, slots=True, kw_only=True)
class RsaPss(Rsa):
    """RSASSA-PSS with a salt as long as the hash: only a component of a composite."""

    def sign(self, handle: Any, data: bytes) -> bytes:
        name = self.digest.name
        signature: bytes = handle.sign(data, _HASH_SALT[name], _HASHES[name])
        return signature

    def check(self, handle: Any, signature: bytes, data: bytes, identifier: bytes) -> None:
        del identifier
        name = self.digest.name
        handle.verify(signature, data, _HASH_SALT[name], _HASHES[name])


@dataclass(frozen=True, slots=True, kw_only=True)
class EdDsa(SignatureAlgorithm):
    """EdDSA (RFC 8032): a component of a composite. No DDS stack accepts it alone."""

    public: type[ed25519.Ed25519PublicKey | ed448.Ed448PublicKey] = field(repr=False)
    private: type[ed25519.Ed25519PrivateKey | ed448.Ed448PrivateKey] = field(repr=False)

    def matches(self, handle: Any) -> bool:
        return isinstance(handle, self.public)

    def raw_public(self, handle: Any) -> bytes:
        data: bytes = handle.public_bytes_raw()
        return data

    def load_raw_public(self, data: bytes) -> Any:
        return self.public.from_public_bytes(data)

    def raw_private(self, handle: Any) -> bytes:
        data: bytes = handle.private_bytes_raw()
        return data

    def load_raw_private(self, data: bytes) -> Any:
        return self.private.from_private_bytes(data)

    def sign(self, handle: Any, data: bytes) -> bytes:
        signature: bytes = handle.sign(data)
        return signature

    def check(self, handle: Any, signature: bytes, data: bytes, identifier: bytes) -> None:
        del identifier
        handle.verify(signature, data)

    def generate_handle(self) -> Any:
        return self.private.generate()
