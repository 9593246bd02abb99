"""ML-KEM (FIPS 203)."""

from dataclasses import field
from typing import Any

from cryptography.hazmat.primitives.asymmetric import mlkem

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._agreement import KeyAgreement


@dataclass(frozen=True, slots=True, kw_only=True)
class MLKEM(KeyAgreement):
    """ML-KEM of one parameter set; dh1 is the encapsulation key, dh2 the ciphertext."""

    private: type[mlkem.MLKEM768PrivateKey | mlkem.MLKEM1024PrivateKey] = field(repr=False)
    encapsulation_key: type[mlkem.MLKEM768PublicKey | mlkem.MLKEM1024PublicKey] = field(repr=False)

    def _generate(self) -> Any:
        return self.private.generate()

    def _public(self, handle: Any) -> bytes:
        data: bytes = handle.public_key().public_bytes_raw()
        return data

    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        # FIPS 203 7.2: the modulus check is in from_public_bytes.
        secret, ciphertext = self.encapsulation_key.from_public_bytes(public).encapsulate()
        return ciphertext, secret

    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        secret: bytes = handle.decapsulate(ciphertext)
        return secret
