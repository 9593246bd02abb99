"""The class of key agreements: a row with its operations, as a KEM.

Diffie-Hellman is modelled as a KEM too: encapsulation generates a second key pair, whose
public key is the ciphertext. So the handshake has one code path for all. A handle is the
key object of the library that does the arithmetic; only rows use it.
"""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import field
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._table import Family, Registered
from pqsec_pki.errors import VerificationError, library_call


@dataclass(frozen=True, slots=True, eq=False)
class KeyPair:
    """An ephemeral key pair: `public` is sent as dh1, the private key stays here."""

    agreement: "KeyAgreement"
    public: bytes
    _handle: Any = field(repr=False)

    def decapsulate(self, ciphertext: bytes) -> bytes:
        """The secret in dh2, `secret_size` bytes; VerificationError if dh2 is invalid.

        ML-KEM cannot detect a wrong ciphertext of the right size: it returns a secret that
        no other party has (FIPS 203, 6.3), and only the first protected message shows it.
        """
        return self.agreement.decapsulate(self._handle, ciphertext)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyAgreement(ABC):
    """One key agreement: its names, its sizes and its operations."""

    name: str
    """Its name on the command line."""
    aliases: tuple[str, ...] = ()
    wire_name: str
    """Its name in c.kagree_algo (DDS-Security 1.1, table 49)."""
    family: Family
    level: int
    """NIST security category; 0 if a quantum computer breaks it."""
    registered: Registered = field(repr=False)
    standard: str
    runs_in: str
    """The stock DDS stacks that support it."""
    public_size: int
    """Bytes of dh1; the maximum, if the size varies."""
    ciphertext_size: int
    """Bytes of dh2; the maximum, if the size varies."""
    secret_size: int
    """Bytes of the secret; the maximum, if the size varies."""

    @property
    def binds_transcript(self) -> bool:
        """Whether SharedSecret depends on the whole handshake, not only on the secret.

        DDS-Security's own agreements do not, for compatibility with stock peers; all
        others do, so that both sides have the same key only for the same handshake.
        """
        return self.family is not Family.CLASSICAL

    @property
    def parts(self) -> "tuple[KeyAgreement, ...]":
        """The agreements that it combines; none if it is not a hybrid."""
        return ()

    def to_json(self) -> dict[str, object]:
        """Its names and sizes, for JSON."""
        return {
            "name": self.name,
            "aliases": self.aliases,
            "family": self.family,
            "level": self.level,
            "dh1_bytes": self.public_size,
            "dh2_bytes": self.ciphertext_size,
            "standard": self.standard,
            "runs_in": self.runs_in,
        }

    def generate(self) -> KeyPair:
        """A new key pair."""
        return self.key_pair(self._generate())

    def key_pair(self, handle: Any) -> KeyPair:
        """`handle`, a private key of this kind, as a value."""
        return KeyPair(self, self._public(handle), handle)

    def encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        """(dh2, secret) for dh1 `public`; VerificationError if it is not a public key."""
        if not self._fits(public, self.public_size):
            raise VerificationError(f"not a {self.name} public key: {len(public)} bytes")
        with library_call(lambda _: VerificationError(f"bad {self.name} public key")):
            return self._encapsulate(public)

    def decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        """The secret in dh2 `ciphertext`; VerificationError if that is invalid."""
        if not self._fits(ciphertext, self.ciphertext_size):
            raise VerificationError(f"not a {self.name} ciphertext: {len(ciphertext)} bytes")
        with library_call(lambda _: VerificationError(f"bad {self.name} ciphertext")):
            return self._decapsulate(handle, ciphertext)

    def shared_secret(self, secret: bytes, signed_reply: bytes) -> bytes:
        """SharedSecret, 32 bytes: every later key is derived from it.

        SHA256(secret) as in DDS-Security (9.3.3, table 52), or, if the row binds
        the transcript, SHA256(secret || SHA256(octets that the Reply's signature covers)).
        """
        if self.binds_transcript:
            secret += hashlib.sha256(signed_reply).digest()
        return hashlib.sha256(secret).digest()

    def _fits(self, data: bytes, size: int) -> bool:
        return len(data) == size

    @abstractmethod
    def _generate(self) -> Any:
        """A new private key."""

    @abstractmethod
    def _public(self, handle: Any) -> bytes:
        """The public key of `handle`, as sent in dh1."""

    @abstractmethod
    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        """(ciphertext, secret); ValueError if `public` is not a public key."""

    @abstractmethod
    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        """The secret; ValueError if `ciphertext` is invalid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hybrid(KeyAgreement):
    """Two agreements side by side: keys, ciphertexts and secrets are concatenated.

    RFC 10024 orders the components differently by curve, so each row has its order.
    The secret is safe as long as one of the two agreements is.
    """

    first: KeyAgreement = field(repr=False)
    second: KeyAgreement = field(repr=False)

    @property
    def parts(self) -> tuple[KeyAgreement, ...]:
        return self.first, self.second

    def _generate(self) -> tuple[KeyPair, KeyPair]:
        return self.first.generate(), self.second.generate()

    def _public(self, handle: Any) -> bytes:
        first, second = handle
        public: bytes = first.public + second.public
        return public

    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        cut = self.first.public_size
        first, first_secret = self.first.encapsulate(public[:cut])
        second, second_secret = self.second.encapsulate(public[cut:])
        return first + second, first_secret + second_secret

    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        first, second = handle
        cut = self.first.ciphertext_size
        secret: bytes = first.decapsulate(ciphertext[:cut]) + second.decapsulate(ciphertext[cut:])
        return secret
