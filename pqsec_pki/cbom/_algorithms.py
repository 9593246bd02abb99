"""Algorithms as assets: pqsec's own rows, symmetric ones, and others by their OID.

Security levels are written only where they are known. Category 0 means that a quantum computer
breaks it.
"""

from collections.abc import Mapping
from typing import Any

from cyclonedx.model.crypto import (
    AlgorithmProperties,
    CryptoAssetType,
    CryptoFunction,
    CryptoMode,
    CryptoPadding,
    CryptoPrimitive,
    CryptoProperties,
)

from pqsec_pki._asn1 import AlgorithmIdentifier, decode
from pqsec_pki.algorithms import SIGNATURES, Family, KeyAgreement, SignatureAlgorithm
from pqsec_pki.cbom._assets import Asset, Assets
from pqsec_pki.inspection import algorithm_name

_SIGN = (CryptoFunction.SIGN, CryptoFunction.VERIFY)
_ENCRYPT = (CryptoFunction.ENCRYPT, CryptoFunction.DECRYPT)
_TAG, _DIGEST = (CryptoFunction.TAG,), (CryptoFunction.DIGEST,)
_DERIVE = (CryptoFunction.KEYDERIVE,)
_AES_GROUP = "2.16.840.1.101.3.4.1"
# The categories of AES and SHA-2 are NIST's definition of categories. GMAC and HMAC have that of
# a search for their key.
_OTHERS: Mapping[str, dict[str, Any]] = {
    "AES256-GCM": {
        "primitive": CryptoPrimitive.AE,
        "parameter_set_identifier": "256",
        "mode": CryptoMode.GCM,
        "crypto_functions": _ENCRYPT,
        "classical_security_level": 256,
        "nist_quantum_security_level": 5,
        "oid": f"{_AES_GROUP}.46",
        "family": "AES",
    },
    "AES256-GMAC": {
        "primitive": CryptoPrimitive.MAC,
        "parameter_set_identifier": "256",
        "mode": CryptoMode.GCM,
        "crypto_functions": _TAG,
        "classical_security_level": 256,
        "nist_quantum_security_level": 5,
        "oid": f"{_AES_GROUP}.49",  # RFC 9044
        "family": "AES",
    },
    **{
        f"AES{bits}-CBC": {
            "primitive": CryptoPrimitive.BLOCK_CIPHER,
            "parameter_set_identifier": str(bits),
            "mode": CryptoMode.CBC,
            "padding": CryptoPadding.PKCS7,
            "crypto_functions": _ENCRYPT,
            "classical_security_level": bits,
            "nist_quantum_security_level": category,
            "oid": f"{_AES_GROUP}.{arc}",
            "family": "AES",
        }
        for bits, category, arc in ((128, 1, 2), (192, 3, 22), (256, 5, 42))
    },
    "HMAC-SHA256": {
        "primitive": CryptoPrimitive.MAC,
        "parameter_set_identifier": "256",
        "crypto_functions": (*_TAG, *_DERIVE),
        "classical_security_level": 256,
        "nist_quantum_security_level": 5,
        "oid": "1.2.840.113549.2.9",
        "family": "HMAC",
    },
    "PBES2": {
        "primitive": CryptoPrimitive.OTHER,
        "crypto_functions": _ENCRYPT,
        "oid": "1.2.840.113549.1.5.13",
        "family": "PBES2",
    },
    "PBKDF2": {
        "primitive": CryptoPrimitive.KDF,
        "crypto_functions": _DERIVE,
        "oid": "1.2.840.113549.1.5.12",
        "family": "PBKDF2",
    },
    "scrypt": {
        "primitive": CryptoPrimitive.KDF,
        "crypto_functions": _DERIVE,
        "oid": "1.3.6.1.4.1.11591.4.11",
        "family": "scrypt",
    },
    **{
        name: {
            "primitive": CryptoPrimitive.HASH,
            "parameter_set_identifier": str(bits),
            "crypto_functions": _DIGEST,
            "classical_security_level": bits // 2,
            "nist_quantum_security_level": {256: 2, 384: 4, 512: 5}[bits],
            "oid": f"2.16.840.1.101.3.4.2.{arc}",
            "family": family,
        }
        for name, family, bits, arc in (
            ("SHA-256", "SHA-2", 256, 1),
            ("SHA-384", "SHA-2", 384, 2),
            ("SHA-512", "SHA-2", 512, 3),
            ("SHA3-256", "SHA-3", 256, 8),
            ("SHA3-384", "SHA-3", 384, 9),
            ("SHA3-512", "SHA-3", 512, 10),
        )
    },
    **{
        name: {
            "primitive": CryptoPrimitive.XOF,
            "parameter_set_identifier": str(bits),
            "crypto_functions": _DIGEST,
            "classical_security_level": bits,
            "oid": f"2.16.840.1.101.3.4.2.{arc}",
            "family": "SHA-3",
        }
        for name, bits, arc in (("SHAKE-128", 128, 11), ("SHAKE-256", 256, 12))
    },
}
_BY_OID = {row["oid"]: name for name, row in _OTHERS.items()}
_PSS = "1.2.840.113549.1.1.10"
_CLASSICAL = ("1.2.840.10045.", "1.2.840.10040.", "1.2.840.113549.1.1.", "1.3.101.11")
"""OIDs of elliptic curves, DSA and RSA, which a quantum computer breaks at any size."""


def signature_row(assets: Assets, row: SignatureAlgorithm) -> str:
    """Add a signature algorithm of pqsec, and those it combines; its ref."""
    parts = tuple(signature_row(assets, each) for each in row.parts)
    primitive = CryptoPrimitive.COMBINER if parts else CryptoPrimitive.SIGNATURE
    padding = CryptoPadding.PKCS1V15 if row.registered.family == "RSASSA-PKCS1" else None
    return _row(assets, row, primitive, _SIGN, parts, padding)


def handshake_row(assets: Assets, row: SignatureAlgorithm) -> str:
    """Like `signature_row`, for signatures in handshakes, where RSA keys sign with PSS."""
    if row.registered.family != "RSASSA-PKCS1":
        return signature_row(assets, row)
    properties = AlgorithmProperties(
        primitive=CryptoPrimitive.SIGNATURE,
        parameter_set_identifier=row.registered.parameter_set,
        padding=CryptoPadding.OTHER,
        crypto_functions=_SIGN,
        classical_security_level=row.registered.classical_level,
        nist_quantum_security_level=row.level,
    )
    return _add(assets, f"{row.name}-pss", properties, _PSS, {"algorithmFamily": "RSASSA-PSS"})


def agreement_row(assets: Assets, row: KeyAgreement) -> str:
    """Add a key agreement of pqsec, and those it combines; its ref."""
    parts = tuple(agreement_row(assets, each) for each in row.parts)
    if row.family is Family.PQ:
        functions = (CryptoFunction.KEYGEN, CryptoFunction.ENCAPSULATE, CryptoFunction.DECAPSULATE)
        return _row(assets, row, CryptoPrimitive.KEM, functions, parts)
    primitive = CryptoPrimitive.COMBINER if parts else CryptoPrimitive.KEY_AGREE
    return _row(assets, row, primitive, (CryptoFunction.KEYGEN, *_DERIVE), parts)


def symmetric(assets: Assets, name: str) -> str:
    """Add the algorithm `name` of the table of others; its ref."""
    row = dict(_OTHERS[name])
    oid, family = row.pop("oid"), row.pop("family")
    return _add(assets, name, AlgorithmProperties(**row), oid, {"algorithmFamily": family})


def digest_named(assets: Assets, name: str) -> str:
    """Add a digest by its name in `smime`, or by its dotted OID; its ref."""
    known = {each.lower().replace("sha-", "sha").replace("-", "_"): each for each in _OTHERS}
    if name in known:
        return symmetric(assets, known[name])
    return by_oid(assets, name, CryptoPrimitive.HASH)


def combination(assets: Assets, name: str, parts: tuple[str, ...]) -> str:
    """Add a scheme of the table of others that is made of the assets `parts`; its ref."""
    row = dict(_OTHERS[name])
    oid, family = row.pop("oid"), row.pop("family")
    words = " and ".join(each.partition(":")[2] for each in parts)
    added = {"algorithmFamily": family}
    return _add(assets, f"{name} with {words}", AlgorithmProperties(**row), oid, added, parts)


def by_oid(assets: Assets, oid: str, primitive: CryptoPrimitive) -> str:
    """Add the algorithm with that dotted OID, which may be unknown; its ref."""
    if name := _BY_OID.get(oid):
        return symmetric(assets, name)
    broken = oid.startswith(_CLASSICAL)
    properties = AlgorithmProperties(
        primitive=primitive, nist_quantum_security_level=0 if broken else None
    )
    dotted = oid if oid[:1].isdigit() else None
    return _add(assets, algorithm_name(oid), properties, dotted, {})


def signed_with(assets: Assets, identifier: bytes, signer: SignatureAlgorithm | None) -> str:
    """Add the algorithm of a signature with that DER AlgorithmIdentifier; its ref.

    `signer` is the row of the signer's key, if it is known: OIDs of ECDSA and RSA name no size.
    """
    oid = decode(AlgorithmIdentifier, identifier, "AlgorithmIdentifier").algorithm.dotted_string
    rows = (signer,) if signer is not None else tuple(SIGNATURES)
    for row in rows:
        if row.identifier == identifier and (signer is row or row.key_oid == oid):
            return signature_row(assets, row)
    return by_oid(assets, oid, CryptoPrimitive.SIGNATURE)


def _row(  # noqa: PLR0913, PLR0917 -- the parts of an algorithm
    assets: Assets,
    row: SignatureAlgorithm | KeyAgreement,
    primitive: CryptoPrimitive,
    functions: tuple[CryptoFunction, ...],
    parts: tuple[str, ...],
    padding: CryptoPadding | None = None,
) -> str:
    registered = row.registered
    properties = AlgorithmProperties(
        primitive=primitive,
        parameter_set_identifier=registered.parameter_set,
        padding=padding,
        crypto_functions=functions,
        classical_security_level=registered.classical_level,
        nist_quantum_security_level=row.level,
    )
    added = {"algorithmFamily": registered.family, "ellipticCurve": registered.curve}
    standard = (("standard", row.standard), ("family", row.family.value))
    return _add(assets, row.name, properties, registered.oid, added, parts, standard)


def _add(  # noqa: PLR0913, PLR0917 -- the parts of an asset
    assets: Assets,
    name: str,
    properties: AlgorithmProperties,
    oid: str | None,
    added: Mapping[str, str | None],
    needs: tuple[str, ...] = (),
    details: tuple[tuple[str, str], ...] = (),
) -> str:
    return assets.add(
        Asset(
            ref=f"algorithm:{name}",
            name=name,
            crypto=CryptoProperties(
                asset_type=CryptoAssetType.ALGORITHM, algorithm_properties=properties, oid=oid
            ),
            needs=needs,
            details=details,
            added={key: value for key, value in added.items() if value is not None},
        )
    )
