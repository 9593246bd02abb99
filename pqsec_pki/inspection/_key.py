"""Describes public and private keys. Of a private key it shows only facts of its public key."""

from typing import TypeVar

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    EncryptedPrivateKeyInfo,
    OneAsymmetricKey,
    PBES2Params,
    PBKDF2Params,
    decode,
    encode,
)
from pqsec_pki.algorithms import SIGNATURES, Family, PrivateKey, load_private_key, pem
from pqsec_pki.errors import MalformedError, PqsecError
from pqsec_pki.inspection import _algorithms
from pqsec_pki.inspection.description import Description, Fact, Value
from pqsec_pki.tokens import uri_in, without_pin

T = TypeVar("T")

_PBES2, _PBKDF2, _SCRYPT = (
    "1.2.840.113549.1.5.13",
    "1.2.840.113549.1.5.12",
    "1.3.6.1.4.1.11591.4.11",
)
_ENCRYPTIONS = ("1.2.840.113549.1.5.", "1.2.840.113549.1.12.1.")
"""PKCS#5 and PKCS#12."""
_CIPHERS = {
    "1.2.840.113549.3.7": "3DES",
    "2.16.840.1.101.3.4.1.2": "AES-128-CBC",
    "2.16.840.1.101.3.4.1.22": "AES-192-CBC",
    "2.16.840.1.101.3.4.1.42": "AES-256-CBC",
}
_FORMS = {
    b"\x80": "seed",
    b"\x30": "seed and expanded key",
    b"\x04": "expanded key without its seed",
}
_TRADITIONAL = {"EC PRIVATE KEY": "SEC 1", "RSA PRIVATE KEY": "PKCS#1"}
SEED_SIZE = 32
FEW_ITERATIONS = 100_000
"""Fewer iterations than this are reported; OpenSSL uses 2048, pqsec 600,000."""
_GUARD = Fact("private", value=True, rows=(("keep", "readable by its owner only (mode 0600)"),))


def describe_public_key(spki: bytes) -> Description:
    """The key in DER SubjectPublicKeyInfo `spki`."""
    facts = (_algorithms.key_fact("key", spki), _algorithms.spki_digest(spki))
    return Description("public key", "Public key", facts)


def describe_private_key(der: bytes) -> Description | None:
    """The unencrypted private key in `der`, PKCS#8 or traditional; None if it is not one."""
    if info := shape(OneAsymmetricKey, der):
        oid = info.algorithm.algorithm.dotted_string
        return _private(der, _pkcs8_form(oid, info.private_key), _algorithms.algorithm_name(oid))
    for label, form in _TRADITIONAL.items():
        key = _loaded(pem(label, der))
        if not isinstance(key, MalformedError):
            return _private(pem(label, der), f"{form}, the traditional form", label.split()[0])
    return None


def describe_encrypted_key(der: bytes) -> Description | None:
    """The encrypted private key in PKCS#8 `der`; None if it is not one."""
    info = shape(EncryptedPrivateKeyInfo, der)
    encryption = _encryption(info.algorithm) if info is not None else None
    return _encrypted("PKCS#8", encryption) if encryption else None


def describe_traditional_encrypted_key(label: str) -> Description:
    """A PEM block with the encryption in its header lines (RFC 1421), as OpenSSL 0.9 wrote it."""
    form = _TRADITIONAL.get(label, label)
    return _encrypted(form, "OpenSSL's old format, weak against guessing: re-encrypt it as PKCS#8")


def describe_reference(data: bytes) -> Description:
    """A file that refers to a private key in a token; MalformedError if it is damaged."""
    uri = without_pin(uri_in(data))
    facts = (Fact.of("key", uri, key="uri"), Fact("private", value=False, rows=()))
    return Description("key reference", "Reference to a private key that is not in a file", facts)


def shape(kind: type[T], der: bytes) -> T | None:
    """`der` as a `kind`, or None. The decoder's message is dropped: it could quote a key."""
    try:
        return decode(kind, der, kind.__name__)
    except MalformedError:
        return None


def _private(data: bytes, form: str, name: str) -> Description:
    key = _loaded(data)
    facts = _unusable(name, _reason(key)) if isinstance(key, PqsecError) else _usable(key)
    state = (Fact("encrypted", value=False, rows=(("", "not encrypted"),)), _GUARD)
    return Description("private key", "Private key", (*facts, Fact.of("form", form), *state))


def _usable(key: PrivateKey) -> tuple[Fact, ...]:
    spki = key.public_key.spki
    return (_algorithms.key_fact("key", spki), _algorithms.spki_digest(spki))


def _unusable(name: str, reason: str) -> tuple[Fact, ...]:
    value: dict[str, Value] = {"algorithm": None, "problem": reason}
    return (Fact.of("key", value, f"{name}, unusable here: {reason}"),)


def _encrypted(form: str, encryption: str) -> Description:
    facts = (
        Fact.of("key", None, "its algorithm is encrypted too: the passphrase is needed"),
        Fact.of("form", form),
        Fact("encrypted", value=True, rows=(("", f"encrypted: {encryption}"),)),
        _GUARD,
    )
    return Description("private key", "Private key, encrypted", facts)


def _loaded(data: bytes) -> PrivateKey | PqsecError:
    try:
        return load_private_key(data)
    except PqsecError as error:
        return error


def _reason(error: PqsecError) -> str:
    """Why a key cannot be used, up to a colon: text after it could quote the key."""
    reason = str(error).partition(":")[0]
    return f"{reason}; {error.hint}" if error.hint else reason


def _pkcs8_form(oid: str, octets: bytes) -> str:
    """The form (RFC 9881, 6) of a post-quantum key, by its size and first byte."""
    if not any(row.key_oid == oid and row.family is Family.PQ for row in SIGNATURES):
        return "PKCS#8"
    form = None if len(octets) == SEED_SIZE else _FORMS.get(octets[:1])
    return f"PKCS#8, {form or 'bare seed, as before RFC 9881'}"


def _encryption(identifier: AlgorithmIdentifier) -> str | None:
    """How the key is encrypted; None if the algorithm does not encrypt private keys."""
    oid = identifier.algorithm.dotted_string
    if not oid.startswith(_ENCRYPTIONS):
        return None
    parameters = shape(PBES2Params, encode(identifier.parameters)) if oid == _PBES2 else None
    if parameters is None:
        return f"an outdated algorithm ({oid})"
    cipher = parameters.encryption.algorithm.dotted_string
    return f"{_derivation(parameters.key_derivation)}, {_CIPHERS.get(cipher, cipher)}"


def _derivation(identifier: AlgorithmIdentifier) -> str:
    oid = identifier.algorithm.dotted_string
    if oid == _SCRYPT:
        return "scrypt"
    found = shape(PBKDF2Params, encode(identifier.parameters)) if oid == _PBKDF2 else None
    if found is None:
        return f"key derivation {oid}"
    few = ", which is too few" if found.iteration_count < FEW_ITERATIONS else ""
    return f"PBKDF2 with {found.iteration_count} iterations{few}"
