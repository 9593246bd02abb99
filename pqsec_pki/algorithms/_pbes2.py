"""Encrypted PKCS#8: PBES2 with PBKDF2-HMAC and AES-256-CBC (RFC 8018).

cryptography writes 2048 iterations and cannot encrypt composite keys, so this module builds
the container and uses cryptography for the arithmetic.
"""

import os
from typing import TypeVar

from cryptography.hazmat.primitives import hashes, padding
from cryptography.hazmat.primitives.ciphers import Cipher, modes
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.kdf.pbkdf2 import PBKDF2HMAC

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    EncryptedPrivateKeyInfo,
    Oid,
    OneAsymmetricKey,
    PBES2Params,
    PBKDF2Params,
    algorithm,
    decode,
    encode,
    raw,
)
from pqsec_pki.errors import MalformedError, PassphraseError, library_call

T = TypeVar("T")

ITERATIONS = 600_000
"""OWASP's minimum for PBKDF2-HMAC-SHA256."""
MAX_ITERATIONS = 10_000_000
"""About a second of work; neither pqsec nor OpenSSL writes files with more."""

_PBES2, _PBKDF2 = "1.2.840.113549.1.5.13", "1.2.840.113549.1.5.12"
_AES_256_CBC = "2.16.840.1.101.3.4.1.42"
_KEY_SIZES = {"2.16.840.1.101.3.4.1.2": 16, "2.16.840.1.101.3.4.1.22": 24, _AES_256_CBC: 32}
"""AES in CBC mode by OID, for reading; pqsec writes AES-256."""
_HMAC_SHA1, _HMAC_SHA256 = "1.2.840.113549.2.7", "1.2.840.113549.2.9"
_PRFS: dict[str, hashes.HashAlgorithm] = {
    _HMAC_SHA1: hashes.SHA1(),  # noqa: S303 -- PBKDF2's default: old files are read, none is written
    _HMAC_SHA256: hashes.SHA256(),
    "1.2.840.113549.2.10": hashes.SHA384(),
    "1.2.840.113549.2.11": hashes.SHA512(),
}
_OTHERWISE = "encrypt it again: openssl pkcs8 -topk8 -v2 aes-256-cbc -in KEY -out NEW"


def encrypt(pkcs8: bytes, passphrase: bytes) -> bytes:
    """DER EncryptedPrivateKeyInfo of `pkcs8`: 600,000 iterations, 16-byte salt."""
    salt, iv = os.urandom(16), os.urandom(16)
    cipher = Cipher(AES(_derive(passphrase, salt, ITERATIONS, _HMAC_SHA256, 32)), modes.CBC(iv))
    padder, encryptor = padding.PKCS7(AES.block_size).padder(), cipher.encryptor()
    padded = padder.update(pkcs8) + padder.finalize()
    derivation = PBKDF2Params(
        salt=salt,
        iteration_count=ITERATIONS,
        key_length=None,
        prf=algorithm(_HMAC_SHA256, null=True),
    )
    parameters = PBES2Params(
        key_derivation=_with(_PBKDF2, encode(derivation)),
        encryption=_with(_AES_256_CBC, encode(iv)),
    )
    return encode(
        EncryptedPrivateKeyInfo(
            algorithm=_with(_PBES2, encode(parameters)),
            encrypted_data=encryptor.update(padded) + encryptor.finalize(),
        )
    )


def is_one(data: bytes) -> bool:
    """Whether `data` is a DER EncryptedPrivateKeyInfo, of any scheme."""
    if not data.startswith(b"\x30"):  # as PEM
        return False
    try:
        decode(EncryptedPrivateKeyInfo, data, "encrypted private key")
    except MalformedError:
        return False
    return True


def decrypt(der: bytes, passphrase: bytes) -> bytes:
    """The PrivateKeyInfo inside; PassphraseError if the passphrase is wrong.

    MalformedError for another scheme than the one above or an invalid iteration count.
    """
    info = decode(EncryptedPrivateKeyInfo, der, "encrypted private key")
    derivation, key_size, iv = _parameters(info.algorithm)
    prf = _HMAC_SHA1 if derivation.prf is None else derivation.prf.algorithm.dotted_string
    if prf not in _PRFS or not 1 <= derivation.iteration_count <= MAX_ITERATIONS:
        raise MalformedError(
            "the private key's encryption has an invalid parameter", hint=_OTHERWISE
        )
    key = _derive(passphrase, derivation.salt, derivation.iteration_count, prf, key_size)
    with library_call(lambda _: PassphraseError("wrong passphrase for the private key")):
        decryptor = Cipher(AES(key), modes.CBC(iv)).decryptor()
        padded = decryptor.update(info.encrypted_data) + decryptor.finalize()
        unpadder = padding.PKCS7(AES.block_size).unpadder()
        plain = unpadder.update(padded) + unpadder.finalize()
    try:  # with a wrong key the padding is valid once in 256
        decode(OneAsymmetricKey, plain, "private key")
    except MalformedError:
        raise PassphraseError("wrong passphrase for the private key") from None
    return plain


def _parameters(identifier: AlgorithmIdentifier) -> tuple[PBKDF2Params, int, bytes]:
    """(derivation, key size in bytes, initialisation vector)."""
    if identifier.algorithm.dotted_string != _PBES2:
        raise MalformedError("the private key is not encrypted with PBES2", hint=_OTHERWISE)
    parameters = _inside(identifier, PBES2Params, "PBES2 parameters")
    key_size = _KEY_SIZES.get(parameters.encryption.algorithm.dotted_string)
    if parameters.key_derivation.algorithm.dotted_string != _PBKDF2 or key_size is None:
        raise MalformedError(
            "the private key is not encrypted with PBKDF2 and AES in CBC mode", hint=_OTHERWISE
        )
    return (
        _inside(parameters.key_derivation, PBKDF2Params, "PBKDF2 parameters"),
        key_size,
        _inside(parameters.encryption, bytes, "initialisation vector"),
    )


def _inside(identifier: AlgorithmIdentifier, kind: type[T], what: str) -> T:
    if identifier.parameters is None:
        raise MalformedError(f"the encrypted private key has no {what}")
    return decode(kind, encode(identifier.parameters), what)


def _derive(passphrase: bytes, salt: bytes, iterations: int, prf: str, size: int) -> bytes:
    return PBKDF2HMAC(_PRFS[prf], size, salt, iterations).derive(passphrase)


def _with(oid: str, parameters: bytes) -> AlgorithmIdentifier:
    return AlgorithmIdentifier(algorithm=Oid(oid), parameters=raw(parameters))
