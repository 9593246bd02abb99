"""Bundles that only one robot can open: a line that says so, for whom, and what is sealed."""

import hashlib

from pqsec_pki.algorithms import SealingPrivateKey, SealingPublicKey
from pqsec_pki.errors import MalformedError, VerificationError

_FIRST = b"pqsec sealed bundle 1\n"
_FINGERPRINT = 32


def is_sealed(data: bytes) -> bool:
    """Whether `data` says that it is a sealed bundle."""
    return data.startswith(_FIRST)


def seal(bundle: bytes, recipient: SealingPublicKey) -> bytes:
    """`bundle` for the holder of `recipient`'s private key alone."""
    head = _head(recipient)
    return head + recipient.seal(bundle, head)


def open_sealed(data: bytes, key: SealingPrivateKey) -> bytes:
    """The bundle in `data`; VerificationError if it is for another key, or was altered."""
    head = _head(key.public_key)
    if len(data) < len(head):
        raise MalformedError("the sealed bundle is cut short")
    if data[: len(head)] != head:
        raise VerificationError(
            "the bundle is sealed for another key",
            hint=f"this robot's key has SHA-256 {fingerprint(key.public_key)}",
        )
    return key.open(data[len(head) :], head)


def fingerprint(key: SealingPublicKey) -> str:
    """SHA-256 of the key, in hex."""
    return hashlib.sha256(key.raw).hexdigest()


def _head(recipient: SealingPublicKey) -> bytes:
    return _FIRST + bytes.fromhex(fingerprint(recipient))
