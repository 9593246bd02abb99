"""Sealed bundles, which only one robot can open: a first line, the recipient, the ciphertext."""

import hashlib

from pqsec_pki.algorithms import SealingPrivateKey, SealingPublicKey
from pqsec_pki.errors import MalformedError, VerificationError

_FIRST = b"pqsec sealed bundle 1\n"


def is_sealed(data: bytes) -> bool:
    """Whether `data` begins like a sealed bundle."""
    return data.startswith(_FIRST)


def seal(bundle: bytes, recipient: SealingPublicKey) -> bytes:
    """`bundle` encrypted for the holder of `recipient`'s private key."""
    head = _header(recipient)
    return head + recipient.seal(bundle, head)


def open_sealed(data: bytes, key: SealingPrivateKey) -> bytes:
    """The bundle in `data`; VerificationError if it was sealed for another key or altered."""
    head = _header(key.public_key)
    if len(data) < len(head):
        raise MalformedError("the sealed bundle is incomplete")
    if data[: len(head)] != head:
        raise VerificationError(
            "the bundle is sealed for another key",
            hint=f"this robot's key has SHA-256 {fingerprint(key.public_key)}",
        )
    return key.open(data[len(head) :], head)


def fingerprint(key: SealingPublicKey) -> str:
    """SHA-256 of the key, in hex."""
    return hashlib.sha256(key.raw).hexdigest()


def _header(recipient: SealingPublicKey) -> bytes:
    return _FIRST + bytes.fromhex(fingerprint(recipient))
