"""Sealing: encrypting to a public key, so that only its holder can read.

HPKE (RFC 9180) in base mode as cryptography has it, with MLKEM768-X25519, HKDF-SHA256 and
AES-256-GCM. Who sealed does not show.
"""

from dataclasses import field
from typing import Self

from cryptography.hazmat.primitives import hpke
from cryptography.hazmat.primitives.asymmetric import mlkem, x25519

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._pem import first_pem, pem
from pqsec_pki.errors import MalformedError, VerificationError, library_call, words_of

_SUITE = hpke.Suite(hpke.KEM.MLKEM768_X25519, hpke.KDF.HKDF_SHA256, hpke.AEAD.AES_256_GCM)
_PUBLIC, _PRIVATE = "PQSEC SEALING PUBLIC KEY", "PQSEC SEALING PRIVATE KEY"
_MLKEM_PUBLIC, _MLKEM_SEED, _X25519 = 1184, 64, 32
"""Bytes."""
MAX_KEY = 16 << 10
"""Bytes of PEM; a public key has 1.7 kB."""


@dataclass(frozen=True, slots=True)
class SealingPublicKey:
    """The recipient of a sealed bundle: an ML-KEM-768 key and an X25519 key."""

    raw: bytes = field(repr=False)
    """Both, ML-KEM first: 1216 bytes."""
    handle: hpke.MLKEM768X25519PublicKey = field(repr=False, compare=False)

    @classmethod
    def from_raw(cls, raw: bytes) -> Self:
        """The inverse of `raw`; MalformedError if it is not such a key."""
        if len(raw) != _MLKEM_PUBLIC + _X25519:
            raise MalformedError(f"not a public key to seal for: {len(raw)} bytes")
        with library_call(
            lambda error: MalformedError(f"not a public key to seal for: {words_of(error)}")
        ):
            first = mlkem.MLKEM768PublicKey.from_public_bytes(raw[:_MLKEM_PUBLIC])
            second = x25519.X25519PublicKey.from_public_bytes(raw[_MLKEM_PUBLIC:])
        return cls(raw, hpke.MLKEM768X25519PublicKey(first, second))

    @classmethod
    def from_pem(cls, data: bytes) -> Self:
        """The first such key in PEM `data`; MalformedError if there is none."""
        try:
            return cls.from_raw(first_pem(data, {_PUBLIC}, "public key to seal for", limit=MAX_KEY))
        except MalformedError as error:
            error.hint = "`pqsec bundle-key` on the robot makes it: bundle.pub.pem"
            raise

    @property
    def pem(self) -> bytes:
        """The key in PEM, under a label of pqsec's: there is no standard for one yet."""
        return pem(_PUBLIC, self.raw)

    def seal(self, data: bytes, info: bytes) -> bytes:
        """`data` for the holder of the private key alone; 1136 bytes longer.

        `info` says what it is for; it is not inside, and must be said again to open.
        """
        return _SUITE.encrypt(data, self.handle, info)


@dataclass(frozen=True, slots=True, eq=False)
class SealingPrivateKey:
    """The key that opens. It prints nothing of itself."""

    public_key: SealingPublicKey
    raw: bytes = field(repr=False)
    """ML-KEM's seed (FIPS 203) and the X25519 key: 96 bytes."""
    handle: hpke.MLKEM768X25519PrivateKey = field(repr=False)

    @classmethod
    def generate(cls) -> Self:
        """A fresh key."""
        first, second = mlkem.MLKEM768PrivateKey.generate(), x25519.X25519PrivateKey.generate()
        return cls._of(first, second)

    @classmethod
    def from_pem(cls, data: bytes) -> Self:
        """The first such key in PEM `data`; MalformedError if there is none."""
        raw = first_pem(data, {_PRIVATE}, "private key to open with", limit=MAX_KEY)
        with library_call(lambda _: MalformedError("not a private key to open with")):
            first = mlkem.MLKEM768PrivateKey.from_seed_bytes(raw[:_MLKEM_SEED])
            second = x25519.X25519PrivateKey.from_private_bytes(raw[_MLKEM_SEED:])
        return cls._of(first, second)

    @classmethod
    def _of(cls, first: mlkem.MLKEM768PrivateKey, second: x25519.X25519PrivateKey) -> Self:
        public = first.public_key().public_bytes_raw() + second.public_key().public_bytes_raw()
        return cls(
            SealingPublicKey.from_raw(public),
            first.private_bytes_raw() + second.private_bytes_raw(),
            hpke.MLKEM768X25519PrivateKey(first, second),
        )

    @property
    def pem(self) -> bytes:
        """The key in PEM, not encrypted."""
        return pem(_PRIVATE, self.raw)

    def open(self, sealed: bytes, info: bytes) -> bytes:
        """The plaintext; VerificationError unless `sealed` is for this key and `info`."""
        with library_call(lambda _: VerificationError("sealed for another key, or altered since")):
            return _SUITE.decrypt(sealed, self.handle, info)
