"""The two keys of a certificate with an alternative signature, acting as one.

X.509 (10/2019) 9.8 defines how such a certificate is signed, but not how its holder
signs. Between two pqsec peers the holder signs handshakes with both keys.
"""

from dataclasses import field, fields
from typing import Any

from cryptography.exceptions import InvalidSignature

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._row import PrivateKey, PublicKey, SignatureAlgorithm
from pqsec_pki.algorithms._table import Family, Registered


def pair_public(key: PublicKey, alternative: PublicKey) -> PublicKey:
    """`key` and `alternative` as one key whose signatures need both."""
    pair = SignaturePair.of(key.algorithm, alternative.algorithm)
    return PublicKey(pair, key.spki, (key.handle, alternative.handle))


def pair_private(key: PrivateKey, alternative: PrivateKey) -> PrivateKey:
    """`key` and `alternative` as one key that signs with both."""
    public = pair_public(key.public_key, alternative.public_key)
    return PrivateKey(public.algorithm, public, (key, alternative))


@dataclass(frozen=True, slots=True, kw_only=True)
class SignaturePair(SignatureAlgorithm):
    """A key and its alternative key: both sign the same octets, both signatures must be valid.

    The signature is ML-DSA's, of fixed size, followed by the plain key's. It exists in
    handshakes only: in certificates the two signatures are separate.
    """

    plain: SignatureAlgorithm = field(repr=False)
    alternative: SignatureAlgorithm = field(repr=False)

    @classmethod
    def of(cls, plain: SignatureAlgorithm, alternative: SignatureAlgorithm) -> "SignaturePair":
        """The row for these two."""
        names = plain.name, alternative.name  # a row's own hash takes all its fields
        found = _MADE.get(names)
        if not found or found.plain is not plain or found.alternative is not alternative:
            found = _MADE[names] = cls._made(plain, alternative)
        return found

    @classmethod
    def _made(cls, plain: SignatureAlgorithm, alternative: SignatureAlgorithm) -> "SignaturePair":
        kept = {field.name: getattr(plain, field.name) for field in fields(SignatureAlgorithm)}
        kept |= {
            "name": f"{plain.name} + {alternative.name}",
            "aliases": (),
            "family": Family.HYBRID,
            "level": alternative.level,
            "registered": Registered(
                classical_level=max(
                    each.registered.classical_level for each in (plain, alternative)
                )
            ),
            "wire_name": f"{plain.wire_name}+{alternative.wire_name}",
            "signature_size": plain.signature_size + alternative.signature_size,
        }
        return cls(**kept, plain=plain, alternative=alternative)

    @property
    def parts(self) -> tuple[SignatureAlgorithm, ...]:
        return self.alternative, self.plain

    def matches(self, handle: Any) -> bool:
        del handle
        return False  # no single public key is a pair: pair_public creates pairs

    def raw_public(self, handle: Any) -> bytes:
        return self.plain.raw_public(handle[0])

    def raw_private(self, handle: Any) -> bytes:
        plain: PrivateKey = handle[0]
        return plain.raw

    def load_raw_public(self, data: bytes) -> Any:
        raise ValueError(f"a pair of keys has no encoding: {len(data)} bytes")

    def load_raw_private(self, data: bytes) -> Any:
        raise ValueError(f"a pair of keys has no encoding: {len(data)} bytes")

    def sign(self, handle: Any, data: bytes) -> bytes:
        plain: PrivateKey
        alternative: PrivateKey
        plain, alternative = handle  # either may be in a token
        return alternative.sign_handshake(data) + plain.sign_handshake(data)

    def check(self, handle: Any, signature: bytes, data: bytes, identifier: bytes) -> None:
        del identifier
        plain, alternative = handle
        cut = self.alternative.signature_size
        if len(signature) <= cut:
            raise InvalidSignature
        self.alternative.check_handshake(alternative, signature[:cut], data)
        self.plain.check_handshake(plain, signature[cut:], data)

    def generate_handle(self) -> Any:
        return self.plain.generate(), self.alternative.generate()


_MADE: dict[tuple[str, str], SignaturePair] = {}
"""Pairs by the names of the two algorithms."""
