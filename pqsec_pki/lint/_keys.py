"""The key of a certificate: its kind, and what it signed."""

import re
from functools import lru_cache

from cryptography import x509
from cryptography.exceptions import InvalidSignature

from pqsec_pki._asn1 import Oid, SubjectPublicKeyInfo, decode, encode
from pqsec_pki.algorithms import Family, PublicKey, load_public_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import (
    MalformedError,
    PqsecError,
    UnknownAlgorithmError,
    VerificationError,
    library_call,
    words_of,
)

UNREADABLE = "unreadable"
_RSA, _EC = "1.2.840.113549.1.1.1", "1.2.840.10045.2.1"
_KINDS = {"1.3.101.112": "ed25519", "1.3.101.113": "ed448", "1.2.840.10040.4.1": "dsa"}
_CURVES = {
    "1.3.36.3.3.2.8.1.1.7": "brainpoolP256r1",
    "1.3.36.3.3.2.8.1.1.11": "brainpoolP384r1",
    "1.3.36.3.3.2.8.1.1.13": "brainpoolP512r1",
    "1.3.132.0.10": "secp256k1",
    "1.3.132.0.33": "ecdsa-p224",
    "1.3.132.0.35": "ecdsa-p521",
    "1.2.840.10045.3.1.1": "ecdsa-p192",
    "1.3.132.0.8": "secp160r1",
    "1.3.132.0.9": "secp160k1",
    "1.3.132.0.30": "secp160r2",
    "1.3.132.0.31": "secp192k1",
    "1.3.132.0.32": "secp224k1",
    "1.3.36.3.3.2.8.1.1.1": "brainpoolP160r1",
    "1.3.36.3.3.2.8.1.1.3": "brainpoolP192r1",
    "1.3.36.3.3.2.8.1.1.5": "brainpoolP224r1",
}
"""Also curves of OpenSSL that nobody should use."""
WEAK_CURVES = frozenset(name for name in _CURVES.values() if re.search("160|192|224", name))


def is_ca(certificate: Certificate) -> bool:
    """Whether basicConstraints marks it as a CA."""
    constraints = certificate.extension(x509.BasicConstraints)
    return constraints is not None and constraints.ca


def key_of(certificate: Certificate) -> PublicKey | None:
    """Its public key; None if pqsec does not support the algorithm."""
    try:
        return certificate.public_key
    except PqsecError:
        return None


def alternative_key_of(certificate: Certificate | None) -> PublicKey | None:
    """Its alternative public key; None if it has none, or pqsec cannot read it."""
    try:
        return certificate.alternative_key if certificate else None
    except PqsecError:
        return None


def is_signed_by(certificate: Certificate, issuer: Certificate) -> bool:
    """Whether `issuer` signed it; True if pqsec cannot check the signature."""
    key = key_of(issuer)
    is_marked_for_it = key is not None and key.algorithm.accepts(certificate.identifier)
    if key is None or (family_of(issuer) is Family.CLASSICAL and not is_marked_for_it):
        return _is_signed_otherwise(certificate, issuer)
    try:
        certificate.verify_signature(key)
    except PqsecError:
        return False
    return True


def _is_signed_otherwise(certificate: Certificate, issuer: Certificate) -> bool:
    """Check signatures that pqsec does not create: other curves, RSASSA-PSS, SHA-1."""
    try:
        with library_call(_not_verified):
            signer = x509.load_der_x509_certificate(issuer.der)
            x509.load_der_x509_certificate(certificate.der).verify_directly_issued_by(signer)
    except VerificationError:
        return False
    except UnknownAlgorithmError:
        return True
    return True


def _not_verified(error: BaseException) -> PqsecError:
    if isinstance(error, InvalidSignature | ValueError):
        return VerificationError("the issuer did not sign it")
    return UnknownAlgorithmError("the library cannot check this kind of signature")


def family_of(certificate: Certificate) -> Family:
    """The family of the key's algorithm; classical for an algorithm that pqsec does not have."""
    key = key_of(certificate)
    return key.algorithm.family if key else Family.CLASSICAL


def key_kind(certificate: Certificate) -> str:
    """The algorithm's name in pqsec, or its common name if pqsec lacks it, such as rsa-1024."""
    return _kind(certificate.spki, certificate.der)


@lru_cache(maxsize=256)
def _kind(spki: bytes, der: bytes) -> str:
    try:
        return load_public_key(spki).algorithm.name
    except UnknownAlgorithmError:
        return _foreign_kind(spki, der)
    except PqsecError:
        return UNREADABLE


def _foreign_kind(spki: bytes, der: bytes) -> str:
    try:
        info = decode(SubjectPublicKeyInfo, spki, "SubjectPublicKeyInfo")
        oid = info.algorithm.algorithm.dotted_string
        if oid == _EC:
            curve = decode(Oid, encode(info.algorithm.parameters), "curve").dotted_string
            return _CURVES.get(curve, f"EC curve {curve}")
        if oid == _RSA:
            # Only for RSA: for other kinds the library tests primes, which takes long.
            return f"rsa-{_size(der)}"
    except PqsecError:
        return UNREADABLE
    return _KINDS.get(oid, f"algorithm {oid}")


def _size(der: bytes) -> int:
    try:
        with library_call(lambda error: MalformedError(words_of(error))):
            return int(getattr(x509.load_der_x509_certificate(der).public_key(), "key_size", 0))
    except MalformedError:
        return 0
