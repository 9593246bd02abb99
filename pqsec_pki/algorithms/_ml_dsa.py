"""ML-DSA (FIPS 204), pure mode with an empty context, as RFC 9881 requires."""

import hashlib
import hmac
from dataclasses import field
from typing import Any

from cryptography.hazmat.primitives.asymmetric import mldsa

from pqsec_pki._asn1 import SeedAndExpandedKey, decode
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._row import PrivateKey, SignatureAlgorithm
from pqsec_pki.errors import MalformedError

_PRIVATE = {
    "ml-dsa-44": mldsa.MLDSA44PrivateKey,
    "ml-dsa-65": mldsa.MLDSA65PrivateKey,
    "ml-dsa-87": mldsa.MLDSA87PrivateKey,
}
_PUBLIC = {
    "ml-dsa-44": mldsa.MLDSA44PublicKey,
    "ml-dsa-65": mldsa.MLDSA65PublicKey,
    "ml-dsa-87": mldsa.MLDSA87PublicKey,
}
SEED_SIZE = 32
_MATRIX = {"ml-dsa-44": (4, 4), "ml-dsa-65": (6, 5), "ml-dsa-87": (8, 7)}
_EXPANDED_SIZE = {"ml-dsa-44": 2560, "ml-dsa-65": 4032, "ml-dsa-87": 4896}
"""k, l and the bytes of an expanded private key (FIPS 204, tables 1 and 2)."""
_RHO_SIZE, _K_SIZE, _TR_SIZE = 32, 32, 64


@dataclass(frozen=True, slots=True, kw_only=True)
class MLDSA(SignatureAlgorithm):
    """ML-DSA of one parameter set."""

    private: Any = field(init=False, repr=False)
    public: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "private", _PRIVATE[self.name])
        object.__setattr__(self, "public", _PUBLIC[self.name])

    def matches(self, handle: Any) -> bool:
        return isinstance(handle, self.public)

    def raw_public(self, handle: Any) -> bytes:
        data: bytes = handle.public_bytes_raw()
        return data

    def load_raw_public(self, data: bytes) -> Any:
        return self.public.from_public_bytes(data)

    def raw_private(self, handle: Any) -> bytes:
        """The seed: 32 bytes."""
        seed: bytes = handle.private_bytes_raw()
        return seed

    def load_raw_private(self, data: bytes) -> Any:
        return self.private.from_seed_bytes(data)

    def sign(self, handle: Any, data: bytes, context: bytes = b"") -> bytes:
        signature: bytes = handle.sign(data, context)
        return signature

    def check(
        self, handle: Any, signature: bytes, data: bytes, identifier: bytes, context: bytes = b""
    ) -> None:
        del identifier
        handle.verify(signature, data, context)

    def load_pkcs8_octets(self, octets: bytes) -> PrivateKey:
        """The key in PKCS#8's privateKey octets: seed, both, or bare seed (RFC 9881 6).

        MalformedError for anything else; an expanded key alone has its own message, because
        a seed cannot be computed from it.
        """
        if len(octets) == 2 + SEED_SIZE and octets[:2] == bytes([0x80, SEED_SIZE]):
            octets = octets[2:]
        if len(octets) == SEED_SIZE:
            return self.private_key(self.load_raw_private(octets))
        if octets[:1] == b"\x30":
            return self._load_both(octets)
        if octets[:1] == b"\x04":
            raise MalformedError(
                f"this {self.name} key has only its expanded form",
                hint="export it again with its seed (OpenSSL: ml-dsa.output_formats=seed-only)",
            )
        raise MalformedError(f"not a private {self.name} key")

    def _load_both(self, octets: bytes) -> PrivateKey:
        try:
            both = decode(SeedAndExpandedKey, octets, f"private {self.name} key")
        except MalformedError:
            # The decoder's own message could quote bytes of the key.
            raise MalformedError(f"not a private {self.name} key") from None
        if len(both.seed) != SEED_SIZE:
            raise MalformedError(f"the seed of this {self.name} key is not 32 bytes")
        key = self.private_key(self.load_raw_private(both.seed))
        begin = self._expanded_begin(both.seed, key.public_key.raw)
        same = hmac.compare_digest(both.expanded_key[: len(begin)], begin)
        if not same or len(both.expanded_key) != _EXPANDED_SIZE[self.name]:
            raise MalformedError(f"the seed and the expanded form of this {self.name} key differ")
        return key

    def _expanded_begin(self, seed: bytes, public: bytes) -> bytes:
        """rho, K and tr: the parts of an expanded key that are digests (FIPS 204, algorithm 6).

        tr is the digest of the whole public key. The rest, s1, s2 and t0, can only be computed
        with the algorithm itself, which no library exposes; it is neither checked nor used.
        """
        digest = hashlib.shake_256(seed + bytes(_MATRIX[self.name])).digest(128)
        return public[:_RHO_SIZE] + digest[-_K_SIZE:] + hashlib.shake_256(public).digest(_TR_SIZE)

    def generate_handle(self) -> Any:
        return self.private.generate()
