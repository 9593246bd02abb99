"""Describes keys and signature algorithms, including those that pqsec does not support."""

import hashlib

from pqsec_pki._asn1 import AlgorithmIdentifier, SubjectPublicKeyInfo, decode
from pqsec_pki.algorithms import SIGNATURES, Family, SignatureAlgorithm, load_public_key
from pqsec_pki.errors import MalformedError, PqsecError
from pqsec_pki.inspection.description import Fact, Value

_FAMILIES = {
    Family.CLASSICAL: "classical: a quantum computer breaks it",
    Family.PQ: "post-quantum",
    Family.HYBRID: "hybrid: a classical and a post-quantum key in one",
}
_OTHERS = {
    "1.2.840.10045.2.1": "an elliptic curve",
    "1.2.840.10045.4.1": "ECDSA with SHA-1",
    "1.2.840.10045.4.3.2": "ECDSA with SHA-256",
    "1.2.840.10045.4.3.3": "ECDSA with SHA-384",
    "1.2.840.10045.4.3.4": "ECDSA with SHA-512",
    "1.2.840.10040.4.1": "DSA",
    "1.2.840.113549.1.1.1": "RSA",
    "1.2.840.113549.1.1.4": "RSA with MD5",
    "1.2.840.113549.1.1.5": "RSA with SHA-1",
    "1.2.840.113549.1.1.10": "RSA-PSS",
    "1.2.840.113549.1.1.11": "RSA with SHA-256",
    "1.2.840.113549.1.1.12": "RSA with SHA-384",
    "1.2.840.113549.1.1.13": "RSA with SHA-512",
    "1.3.101.110": "X25519",
    "1.3.101.111": "X448",
    "1.3.101.112": "Ed25519",
    "1.3.101.113": "Ed448",
    "2.16.840.1.101.3.4.4.1": "ML-KEM-512",
    "2.16.840.1.101.3.4.4.2": "ML-KEM-768",
    "2.16.840.1.101.3.4.4.3": "ML-KEM-1024",
}
"""Common algorithms that are not in the table. A row with an OID of its own has the row's name."""


def algorithm_name(oid: str) -> str:
    """The name for the OID of a key or signature; the OID itself if it is not known."""
    return _own_names().get(oid) or _OTHERS.get(oid, oid)


def _own_names() -> dict[str, str]:
    return {row.key_oid: row.name for row in SIGNATURES if oid_of(row.identifier) == row.key_oid}


def oid_of(identifier: bytes) -> str:
    """Dotted OID of a DER AlgorithmIdentifier."""
    return decode(AlgorithmIdentifier, identifier, "AlgorithmIdentifier").algorithm.dotted_string


def row_words(row: SignatureAlgorithm) -> str:
    """A row's name and its security."""
    level = f", NIST level {row.level}" if row.level else ""
    return f"{row.name} ({_FAMILIES[row.family]}{level})"


def key_fact(label: str, spki: bytes) -> Fact:
    """The public key in DER SubjectPublicKeyInfo `spki`, also if its algorithm is unsupported."""
    digest = hashlib.sha256(spki).hexdigest()
    try:
        row = load_public_key(spki).algorithm
    except PqsecError as error:
        value: dict[str, Value] = {"algorithm": None, "sha256": digest, "problem": str(error)}
        return Fact.of(label, value, f"{_spki_name(spki)}, unusable here: {error}")
    return Fact.of(label, {**row_value(row), "sha256": digest}, row_words(row))


def alternative_key_fact(spki: bytes | None) -> Fact:
    """The alternative public key in `spki`, if there is one."""
    label = "alternative key"
    return key_fact(label, spki) if spki else Fact.of(label, None, "none")


def row_value(row: SignatureAlgorithm) -> dict[str, Value]:
    """A row as a JSON value."""
    return {"algorithm": row.name, "family": row.family.value, "nist_level": row.level}


def spki_digest(spki: bytes) -> Fact:
    """The digest by which to find the private key of this public key."""
    return Fact.of("public key SHA-256", hashlib.sha256(spki).hexdigest(), key="public_key_sha256")


def identity_stacks(spki: bytes, identifier: bytes) -> str | None:
    """Which stacks take an identity with that key, so signed; None where no row is for it."""
    try:
        row = load_public_key(spki).algorithm
    except PqsecError:
        return None
    # A stack that cannot check the CA's signature cannot take the identity either.
    signers = [each for each in SIGNATURES if each.accepts(identifier)]
    if signers and all(each.family is not Family.CLASSICAL for each in signers):
        return signers[0].runs_in
    return row.runs_in


def _spki_name(spki: bytes) -> str:
    try:
        info = decode(SubjectPublicKeyInfo, spki, "public key")
    except MalformedError:
        return "unreadable"
    return algorithm_name(info.algorithm.algorithm.dotted_string)
