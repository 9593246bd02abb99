"""X-Wing (draft-connolly-cfrg-xwing-kem): ML-KEM-768 and X25519 with a combiner. Experimental.

docs/reference/algorithms.md explains this file as an example of an added algorithm.
"""

import hashlib
import secrets

from cryptography.hazmat.primitives.asymmetric import mlkem, x25519

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._agreement import Hybrid, KeyAgreement, KeyPair
from pqsec_pki.algorithms._table import Family, Registered

_LABEL = rb"\.//^" + b"\\"
_SEED_SIZE, _ML_KEM_SEED_SIZE, _X25519_SIZE = 32, 64, 32


@dataclass(frozen=True, slots=True, kw_only=True)
class XWing(Hybrid):
    """Keys and ciphertexts are those of both halves; the secret is a hash, 32 bytes."""

    def from_seed(self, seed: bytes) -> KeyPair:
        """The key pair of the draft's private key `seed`, 32 bytes."""
        expanded = hashlib.shake_256(seed).digest(_ML_KEM_SEED_SIZE + _X25519_SIZE)
        first = mlkem.MLKEM768PrivateKey.from_seed_bytes(expanded[:_ML_KEM_SEED_SIZE])
        second = x25519.X25519PrivateKey.from_private_bytes(expanded[_ML_KEM_SEED_SIZE:])
        return self.key_pair((self.first.key_pair(first), self.second.key_pair(second)))

    def generate(self) -> KeyPair:
        return self.from_seed(secrets.token_bytes(_SEED_SIZE))

    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        ciphertext, both = super(XWing, self)._encapsulate(public)  # noqa: UP008 -- slots make another class
        return ciphertext, _combined(both, ciphertext, public)

    def _decapsulate(self, handle: tuple[KeyPair, KeyPair], ciphertext: bytes) -> bytes:
        both = super(XWing, self)._decapsulate(handle, ciphertext)  # noqa: UP008 -- slots make another class
        return _combined(both, ciphertext, handle[1].public)


def _combined(both: bytes, ciphertext: bytes, public: bytes) -> bytes:
    """The secret of the two secrets, and of X25519's ciphertext and public key, which come last."""
    x25519_half = ciphertext[-_X25519_SIZE:] + public[-_X25519_SIZE:]
    return hashlib.sha3_256(both + x25519_half + _LABEL).digest()


def x_wing(ml_kem: KeyAgreement, x25519_row: KeyAgreement) -> XWing:
    """The row, made of the rows of ML-KEM-768 and X25519."""
    return XWing(
        name="xwing",
        aliases=("x-wing",),
        wire_name="X-Wing",
        family=Family.HYBRID,
        level=1,  # the draft claims no more
        registered=Registered(oid="1.3.6.1.4.1.62253.25722", classical_level=128),
        standard="draft-connolly-cfrg-xwing-kem",
        runs_in="no stock stack today",
        public_size=ml_kem.public_size + x25519_row.public_size,
        ciphertext_size=ml_kem.ciphertext_size + x25519_row.ciphertext_size,
        secret_size=32,
        first=ml_kem,
        second=x25519_row,
    )
