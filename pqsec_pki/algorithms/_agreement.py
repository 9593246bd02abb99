"""What a key agreement is: a row that acts, in the shape of a KEM.

A Diffie-Hellman exchange fits that shape too: to encapsulate is to make a second key
pair, and its public half is the ciphertext. So the handshake has one path for all. A
handle is the key object of whatever library does the arithmetic; only rows touch it.
"""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

from pqsec_pki.algorithms._table import Family
from pqsec_pki.errors import VerificationError


@dataclass(frozen=True, slots=True, eq=False)
class KeyPair:
    """An ephemeral key pair: `public` goes out as dh1, the private half stays here."""

    agreement: "KeyAgreement"
    public: bytes
    _handle: Any = field(repr=False)

    def decapsulate(self, ciphertext: bytes) -> bytes:
        """The secret in dh2, `secret_size` bytes; VerificationError if it can hold none.

        ML-KEM cannot tell a wrong ciphertext of the right size: it gives a secret that
        nobody else has (FIPS 203, 6.3), and only the first protected message shows it.
        """
        return self.agreement.decapsulate(self._handle, ciphertext)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyAgreement(ABC):
    """One key agreement: its names, its sizes, and everything it can do."""

    name: str
    """What a user types."""
    aliases: tuple[str, ...] = ()
    wire_name: str
    """What the handshake carries in c.kagree_algo (DDS-Security 1.1, table 49)."""
    family: Family
    level: int
    """NIST security category; 0 where a quantum computer breaks it."""
    standard: str
    runs_in: str
    """Which stock DDS stacks run it."""
    public_size: int
    """Bytes of dh1; the most, where they vary."""
    ciphertext_size: int
    """Bytes of dh2; the most, where they vary."""
    secret_size: int
    """Bytes of the secret; the most, where they vary."""

    @property
    def binds_transcript(self) -> bool:
        """Whether SharedSecret depends on the whole handshake, not only on the secret.

        DDS-Security's own agreements cannot, or stock peers would not understand; all
        others do, so that what was signed is also what was keyed.
        """
        return self.family is not Family.CLASSICAL

    def generate(self) -> KeyPair:
        """A fresh key pair."""
        return self.key_pair(self._generate())

    def key_pair(self, handle: Any) -> KeyPair:
        """`handle`, a private key of this kind, as a value."""
        return KeyPair(self, self._public(handle), handle)

    def encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        """(dh2, secret) for dh1 `public`; VerificationError if that is no public key."""
        if not self._fits(public, self.public_size):
            raise VerificationError(f"not a {self.name} public key: {len(public)} bytes")
        try:
            return self._encapsulate(public)
        except ValueError as error:
            raise VerificationError(f"bad {self.name} public key") from error

    def decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        """The secret in dh2 `ciphertext`; VerificationError if it can hold none."""
        if not self._fits(ciphertext, self.ciphertext_size):
            raise VerificationError(f"not a {self.name} ciphertext: {len(ciphertext)} bytes")
        try:
            return self._decapsulate(handle, ciphertext)
        except ValueError as error:
            raise VerificationError(f"bad {self.name} ciphertext") from error

    def shared_secret(self, secret: bytes, signed_reply: bytes) -> bytes:
        """SharedSecret, 32 bytes: what every later key is derived from.

        SHA256(secret) as DDS-Security has it (9.3.3, table 52), or, where the row binds
        the transcript, SHA256(secret || SHA256(octets that the Reply's signature covers)).
        """
        if self.binds_transcript:
            secret += hashlib.sha256(signed_reply).digest()
        return hashlib.sha256(secret).digest()

    def _fits(self, data: bytes, size: int) -> bool:
        return len(data) == size

    @abstractmethod
    def _generate(self) -> Any:
        """A fresh private key."""

    @abstractmethod
    def _public(self, handle: Any) -> bytes:
        """The public half of `handle`, as dh1 carries it."""

    @abstractmethod
    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        """(ciphertext, secret); ValueError if `public` is no public key."""

    @abstractmethod
    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        """The secret; ValueError if `ciphertext` can hold none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hybrid(KeyAgreement):
    """Two agreements side by side: keys, ciphertexts and secrets are concatenated.

    RFC 10024 orders the halves differently by curve, so each row says what is first.
    The secret is safe while either half is.
    """

    first: KeyAgreement = field(repr=False)
    second: KeyAgreement = field(repr=False)

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
