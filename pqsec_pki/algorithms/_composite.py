"""Composite ML-DSA: two algorithms as one, with one key and one OID.

draft-ietf-lamps-pq-composite-sigs-19, in the RFC Editor's queue. A row consists of two
rows.
"""

from collections.abc import Callable
from dataclasses import field
from typing import Any

from pqsec_pki._asn1 import (
    OneAsymmetricKey,
    SubjectPublicKeyInfo,
    algorithm,
    bits,
    encode,
)
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._ml_dsa import MLDSA, SEED_SIZE
from pqsec_pki.algorithms._row import SignatureAlgorithm

_PREFIX = b"CompositeAlgorithmSignatures2025"
_MAX_CONTEXT = 255


@dataclass(frozen=True, slots=True, kw_only=True)
class Composite(SignatureAlgorithm):
    """ML-DSA and a traditional algorithm under one OID; a signature needs both.

    Keys and signatures are the plain concatenation of both, ML-DSA first.
    """

    ml_dsa: MLDSA = field(repr=False)
    traditional: SignatureAlgorithm = field(repr=False)
    prehash: Callable[[bytes], bytes] = field(repr=False)
    label: bytes = field(repr=False)

    @property
    def parts(self) -> tuple[SignatureAlgorithm, ...]:
        return self.ml_dsa, self.traditional

    def matches(self, handle: Any) -> bool:
        return (
            isinstance(handle, tuple)
            and self.ml_dsa.matches(handle[0])
            and self.traditional.matches(handle[1])
        )

    def raw_public(self, handle: Any) -> bytes:
        return self.ml_dsa.raw_public(handle[0]) + self.traditional.raw_public(handle[1])

    def load_raw_public(self, data: bytes) -> Any:
        cut = self.ml_dsa.public_key_size
        return (
            self.ml_dsa.load_raw_public(data[:cut]),
            self.traditional.load_raw_public(data[cut:]),
        )

    def raw_private(self, handle: Any) -> bytes:
        return self.ml_dsa.raw_private(handle[0]) + self.traditional.raw_private(handle[1])

    def load_raw_private(self, data: bytes) -> Any:
        return (
            self.ml_dsa.load_raw_private(data[:SEED_SIZE]),
            self.traditional.load_raw_private(data[SEED_SIZE:]),
        )

    def sign(self, handle: Any, data: bytes, context: bytes = b"") -> bytes:
        message = self._message(data, context)
        return self.ml_dsa.sign(handle[0], message, self.label) + self.traditional.sign(
            handle[1], message
        )

    def check(
        self, handle: Any, signature: bytes, data: bytes, identifier: bytes, context: bytes = b""
    ) -> None:
        del identifier
        cut = self.ml_dsa.signature_size
        message = self._message(data, context)
        self.ml_dsa.check(handle[0], signature[:cut], message, b"", self.label)
        rest = signature[cut:]
        self.traditional.check(handle[1], rest, message, self.traditional.identifier)

    def pkcs8(self, handle: Any) -> bytes:
        return encode(
            OneAsymmetricKey(
                version=0,
                algorithm=algorithm(self.key_oid),
                private_key=self.raw_private(handle),
                attributes=None,
                public_key=None,
            )
        )

    def _message(self, data: bytes, context: bytes) -> bytes:
        """M' of the draft, section 3.2; ValueError if the context is over 255 bytes."""
        if len(context) > _MAX_CONTEXT:
            raise ValueError("context too long")
        return _PREFIX + self.label + bytes([len(context)]) + context + self.prehash(data)

    def generate_handle(self) -> Any:
        return self.ml_dsa.generate_handle(), self.traditional.generate_handle()

    def _public(self, handle: Any) -> Any:
        return handle[0].public_key(), handle[1].public_key()

    def _spki(self, handle: Any) -> bytes:
        return encode(
            SubjectPublicKeyInfo(
                algorithm=algorithm(self.key_oid), subject_public_key=bits(self.raw_public(handle))
            )
        )
