"""The table of signature algorithms: for CAs, participants and signed documents.

To add one, write its row. Nothing else in the package names an algorithm; the command
line, the self-check and the tests follow the table.
"""

import hashlib
import re
from collections.abc import Callable
from typing import Any

from cryptography.hazmat.primitives.asymmetric import ec, ed448, ed25519

from pqsec_pki._asn1 import algorithm, encode
from pqsec_pki.algorithms._classical import ECDSA_WITH, RSA_WITH, Ecdsa, EdDsa, Rsa, RsaPss
from pqsec_pki.algorithms._composite import Composite
from pqsec_pki.algorithms._ml_dsa import MLDSA
from pqsec_pki.algorithms._row import SignatureAlgorithm
from pqsec_pki.algorithms._table import AlgorithmTable, Family, Registered
from pqsec_pki.algorithms.digest import (
    SHA3_256,
    SHA3_384,
    SHA3_512,
    SHA256,
    SHA384,
    SHA512,
    SHAKE128,
    SHAKE256,
    Digest,
)

_SHA2 = frozenset({SHA256, SHA384, SHA512})
EVERYWHERE = "all stock stacks"
FAST_ONLY = "Fast DDS, OpenDDS"
NOWHERE = "no stock stack today"


def _ecdsa(curve: ec.EllipticCurve, oid: str, digest: Digest, group: str, runs_in: str) -> Ecdsa:
    """ECDSA on `curve`, whose name in CycloneDX's registry is `group`."""
    bits = curve.key_size
    short = group.rpartition("/")[2].lower().replace("p-", "p")
    integer = bits // 8 + 1  # bytes of a positive INTEGER of that many bits
    content = 2 * (2 + integer)
    return Ecdsa(
        name=f"ecdsa-{short}",
        aliases=(short, f"ec-{short}"),
        family=Family.CLASSICAL,
        level=0,
        registered=Registered(
            oid=ECDSA_WITH[digest.name],
            family="ECDSA",
            parameter_set=str(bits),
            curve=group,
            classical_level=min(bits // 2, 256),
        ),
        standard="FIPS 186-5" if group.startswith("nist") else "RFC 5639",
        runs_in=runs_in,
        # DDS-Security 1.1 names P-256 only; for P-384 this is 1.2's word.
        wire_name="ECDSA-SHA256" if short == "p256" else f"ECDSA+{short.upper()}+SHA{bits}",
        token_name=f"EC-{'prime256v1' if short == 'p256' else curve.name}",
        key_oid="1.2.840.10045.2.1",
        identifier=encode(algorithm(ECDSA_WITH[digest.name])),
        digest=digest,
        cms_digests=_SHA2,
        public_key_size=1 + 2 * ((bits + 7) // 8),
        signature_size=content + (2 if content < 128 else 3),  # noqa: PLR2004 -- DER: a long length
        curve=curve,
        curve_oid=oid,
    )


def _rsa(bits: int, kind: type[Rsa] = Rsa, digest: Digest = SHA256) -> Rsa:
    suffix = "-pss" if kind is RsaPss else "" if digest is SHA256 else f"-{digest.name}"
    return kind(
        name=f"rsa-{bits}{suffix}",
        aliases=(f"rsa{bits}{suffix}",),
        family=Family.CLASSICAL,
        level=0,
        registered=Registered(
            oid=RSA_WITH[digest.name] if kind is Rsa else "1.2.840.113549.1.1.10",
            family="RSASSA-PKCS1" if kind is Rsa else "RSASSA-PSS",
            parameter_set=str(bits),
            classical_level=112 if bits == 2048 else 128,  # noqa: PLR2004 -- the rows of SP 800-57
        ),
        standard="RFC 8017",
        # At 4096 bits the handshake is over the 8192 bytes that Fast DDS 3.1.2 can take.
        runs_in={2048: EVERYWHERE, 3072: FAST_ONLY}.get(bits, f"{FAST_ONLY}; crashes Fast DDS 3.1"),
        wire_name="RSASSA-PSS-SHA256",
        token_name=f"RSA-{bits}",
        key_oid="1.2.840.113549.1.1.1",
        identifier=encode(algorithm(RSA_WITH[digest.name], null=True)),
        digest=digest,
        cms_digests=_SHA2,
        public_key_size=bits // 8 + 14,
        signature_size=bits // 8,
        bits=bits,
    )


def _ml_dsa(
    size: int, level: int, public_key: int, signature: int, digests: frozenset[Digest]
) -> MLDSA:
    arc = {44: 17, 65: 18, 87: 19}[size]
    oid = f"2.16.840.1.101.3.4.3.{arc}"
    return MLDSA(
        name=f"ml-dsa-{size}",
        aliases=(f"mldsa{size}", f"mldsa-{size}"),
        family=Family.PQ,
        level=level,
        registered=Registered(
            oid=oid,
            family="ML-DSA",
            parameter_set=str(size),
            classical_level={2: 128, 3: 192, 5: 256}[level],
        ),
        standard="FIPS 204, RFC 9881",
        runs_in=NOWHERE,
        wire_name=f"ML-DSA-{size}",
        token_name=f"ML-DSA-{size}",
        key_oid=oid,
        identifier=encode(algorithm(oid)),
        digest=SHA512,  # RFC 9882 3.3: every verifier must have it
        cms_digests=digests,
        public_key_size=public_key,
        signature_size=signature,
    )


# RFC 9882 3.3, table 1: digests at least as strong as the key.
_DIGESTS_87 = frozenset({SHA512, SHA3_512, SHAKE256})
_DIGESTS_65 = _DIGESTS_87 | {SHA384, SHA3_384}
_DIGESTS_44 = _DIGESTS_65 | {SHA256, SHA3_256, SHAKE128}

ECDSA_P256 = _ecdsa(ec.SECP256R1(), "1.2.840.10045.3.1.7", SHA256, "nist/P-256", EVERYWHERE)
ECDSA_P384 = _ecdsa(ec.SECP384R1(), "1.3.132.0.34", SHA384, "nist/P-384", FAST_ONLY)
RSA_2048, RSA_3072, RSA_4096 = _rsa(2048), _rsa(3072), _rsa(4096)
ML_DSA_44 = _ml_dsa(44, 2, 1312, 2420, _DIGESTS_44)
ML_DSA_65 = _ml_dsa(65, 3, 1952, 3309, _DIGESTS_65)
ML_DSA_87 = _ml_dsa(87, 5, 2592, 4627, _DIGESTS_87)
_PREHASHES: dict[Digest, Callable[[bytes], bytes]] = {
    SHA256: lambda data: hashlib.sha256(data).digest(),
    SHA512: lambda data: hashlib.sha512(data).digest(),
    SHAKE256: lambda data: hashlib.shake_256(data).digest(64),
}


def _composite(
    arc: int, draft_name: str, short: str, ml_dsa: MLDSA, traditional: SignatureAlgorithm
) -> Composite:
    oid = f"1.3.6.1.5.5.7.6.{arc}"
    end = draft_name.rpartition("-")[2]
    prehash = {"SHA256": SHA256, "SHA512": SHA512, "SHAKE256": SHAKE256}[end]
    return Composite(
        name=draft_name.lower(),
        aliases=(short,),
        family=Family.HYBRID,
        level=ml_dsa.level,
        registered=Registered(oid=oid, classical_level=ml_dsa.registered.classical_level),
        standard="draft-ietf-lamps-pq-composite-sigs-19 (RFC to be, OID final)",
        runs_in=NOWHERE,
        wire_name=draft_name,
        token_name=draft_name,
        key_oid=oid,
        identifier=encode(algorithm(oid)),
        digest=prehash,  # draft-ietf-lamps-cms-composite-sigs: equal to the pre-hash
        cms_digests=frozenset({prehash}),
        public_key_size=ml_dsa.public_key_size + traditional.public_key_size,
        signature_size=ml_dsa.signature_size + traditional.signature_size,
        ml_dsa=ml_dsa,
        traditional=traditional,
        prehash=_PREHASHES[prehash],
        label=b"COMPSIG-" + re.sub(r"brainpoolP(\d+)r1", r"BP\1", draft_name).encode(),
    )


def _eddsa(
    name: str, oid: str, level: int, sizes: tuple[int, int], classes: tuple[type[Any], type[Any]]
) -> EdDsa:
    """EdDSA; sizes of public key and signature, and the classes of public and private key."""
    return EdDsa(
        name=name.lower(),
        family=Family.CLASSICAL,
        level=0,
        registered=Registered(
            oid=oid, family="EdDSA", curve=f"other/{name}", classical_level=level
        ),
        standard="RFC 8032",
        runs_in=NOWHERE,
        wire_name=name,
        token_name=name,
        key_oid=oid,
        identifier=encode(algorithm(oid)),
        digest=SHA512,
        cms_digests=frozenset({SHA512}),
        public_key_size=sizes[0],
        signature_size=sizes[1],
        public=classes[0],
        private=classes[1],
    )


# Halves of composites only: no stack takes them alone.
_ED25519 = _eddsa(
    "Ed25519",
    "1.3.101.112",
    128,
    (32, 64),
    (ed25519.Ed25519PublicKey, ed25519.Ed25519PrivateKey),
)
_ED448 = _eddsa(
    "Ed448", "1.3.101.113", 224, (57, 114), (ed448.Ed448PublicKey, ed448.Ed448PrivateKey)
)
_P521 = _ecdsa(ec.SECP521R1(), "1.3.132.0.35", SHA512, "nist/P-521", NOWHERE)
_BP256, _BP384 = (
    _ecdsa(curve, f"1.3.36.3.3.2.8.1.1.{arc}", digest, f"brainpool/{curve.name}", NOWHERE)
    for curve, arc, digest in (
        (ec.BrainpoolP256R1(), 7, SHA256),
        (ec.BrainpoolP384R1(), 11, SHA384),
    )
)
_RSA_2048_PSS, _RSA_3072_PSS = _rsa(2048, RsaPss), _rsa(3072, RsaPss)
_RSA_4096_PSS, _RSA_4096_SHA384 = _rsa(4096, RsaPss, SHA384), _rsa(4096, Rsa, SHA384)

COMPOSITES = (
    _composite(37, "MLDSA44-RSA2048-PSS-SHA256", "mldsa44+rsa2048", ML_DSA_44, _RSA_2048_PSS),
    _composite(38, "MLDSA44-RSA2048-PKCS15-SHA256", "mldsa44+rsa2048-v15", ML_DSA_44, RSA_2048),
    _composite(39, "MLDSA44-Ed25519-SHA512", "mldsa44+ed25519", ML_DSA_44, _ED25519),
    _composite(40, "MLDSA44-ECDSA-P256-SHA256", "mldsa44+p256", ML_DSA_44, ECDSA_P256),
    _composite(41, "MLDSA65-RSA3072-PSS-SHA512", "mldsa65+rsa3072", ML_DSA_65, _RSA_3072_PSS),
    _composite(42, "MLDSA65-RSA3072-PKCS15-SHA512", "mldsa65+rsa3072-v15", ML_DSA_65, RSA_3072),
    _composite(43, "MLDSA65-RSA4096-PSS-SHA512", "mldsa65+rsa4096", ML_DSA_65, _RSA_4096_PSS),
    _composite(
        44, "MLDSA65-RSA4096-PKCS15-SHA512", "mldsa65+rsa4096-v15", ML_DSA_65, _RSA_4096_SHA384
    ),
    _composite(45, "MLDSA65-ECDSA-P256-SHA512", "mldsa65+p256", ML_DSA_65, ECDSA_P256),
    _composite(46, "MLDSA65-ECDSA-P384-SHA512", "mldsa65+p384", ML_DSA_65, ECDSA_P384),
    _composite(47, "MLDSA65-ECDSA-brainpoolP256r1-SHA512", "mldsa65+bp256", ML_DSA_65, _BP256),
    _composite(48, "MLDSA65-Ed25519-SHA512", "mldsa65+ed25519", ML_DSA_65, _ED25519),
    _composite(49, "MLDSA87-ECDSA-P384-SHA512", "mldsa87+p384", ML_DSA_87, ECDSA_P384),
    _composite(50, "MLDSA87-ECDSA-brainpoolP384r1-SHA512", "mldsa87+bp384", ML_DSA_87, _BP384),
    _composite(51, "MLDSA87-Ed448-SHAKE256", "mldsa87+ed448", ML_DSA_87, _ED448),
    _composite(52, "MLDSA87-RSA3072-PSS-SHA512", "mldsa87+rsa3072", ML_DSA_87, _RSA_3072_PSS),
    _composite(53, "MLDSA87-RSA4096-PSS-SHA512", "mldsa87+rsa4096", ML_DSA_87, _RSA_4096_PSS),
    _composite(54, "MLDSA87-ECDSA-P521-SHA512", "mldsa87+p521", ML_DSA_87, _P521),
)

SIGNATURES = AlgorithmTable[SignatureAlgorithm](
    "signature algorithm",
    [
        ECDSA_P256,
        ECDSA_P384,
        RSA_2048,
        RSA_3072,
        RSA_4096,
        ML_DSA_44,
        ML_DSA_65,
        ML_DSA_87,
        *COMPOSITES,
    ],
    foreign=("pqsec.signatures", SignatureAlgorithm),
)
