"""The table of key agreements, with which two participants establish a shared secret.

To add one, write its row. Nothing else in the package names a key agreement; the
command line, the self-check and the tests follow the table.
"""

from dataclasses import replace

from cryptography.hazmat.primitives.asymmetric import ec, mlkem

from pqsec_pki.algorithms._agreement import Hybrid, KeyAgreement, KeyPair
from pqsec_pki.algorithms._diffie_hellman import ECDH, MODP, X25519
from pqsec_pki.algorithms._ml_kem import MLKEM
from pqsec_pki.algorithms._table import AlgorithmTable, Family, Registered
from pqsec_pki.algorithms._xwing import x_wing

__all__ = ["KEY_AGREEMENTS", "MODP_DER", "MODP_RAW", "KeyAgreement", "KeyPair"]

_PQSEC_ONLY = "no stock stack today"

ECDH_P256 = ECDH(
    name="ecdh-p256",
    aliases=("p256", "ecdhe-p256"),
    wire_name="ECDH+prime256v1-CEUM",
    family=Family.CLASSICAL,
    level=0,
    registered=Registered(
        oid="1.3.132.1.12", family="ECDH", curve="nist/P-256", classical_level=128
    ),
    standard="NIST SP 800-56A",
    runs_in="all stock stacks",
    public_size=65,
    ciphertext_size=65,
    secret_size=32,
    curve=ec.SECP256R1(),
)
ECDH_P384 = ECDH(
    name="ecdh-p384",
    aliases=("p384", "ecdhe-p384"),
    # DDS-Security 1.1 has no name for it. This is 1.2's, as RTI's manual writes it.
    wire_name="ECDHE-CEUM+P384",
    family=Family.CLASSICAL,
    level=0,
    registered=Registered(
        oid="1.3.132.1.12", family="ECDH", curve="nist/P-384", classical_level=192
    ),
    standard="NIST SP 800-56A",
    runs_in="no open stack; DDS-Security 1.2",
    public_size=97,
    ciphertext_size=97,
    secret_size=48,
    curve=ec.SECP384R1(),
)
DH_MODP_2048_256 = MODP(
    name="dh-modp-2048-256",
    aliases=("modp", "dh-modp", "ffdhe-rfc5114"),
    wire_name="DH+MODP-2048-256",
    family=Family.CLASSICAL,
    level=0,
    registered=Registered(family="FFDH", parameter_set="2048", classical_level=112),
    standard="RFC 5114 2.3",
    runs_in="all stock stacks, but Cyclone DDS with itself only",
    public_size=261,
    ciphertext_size=261,
    secret_size=256,
)
MODP_DER = replace(DH_MODP_2048_256, name="dh-modp-2048-256 (DER)", aliases=(), der=True)
"""The encoding of Cyclone DDS. For the models of stacks; not in the table."""
MODP_RAW = replace(DH_MODP_2048_256, name="dh-modp-2048-256 (raw)", aliases=(), der=False)
"""The encoding of Fast DDS and OpenDDS."""
_X25519 = X25519(
    name="x25519",
    wire_name="X25519",
    family=Family.CLASSICAL,
    level=0,
    registered=Registered(
        oid="1.3.101.110", family="ECDH", curve="other/Curve25519", classical_level=128
    ),
    standard="RFC 7748",
    runs_in="no stack alone: half of a hybrid",
    public_size=32,
    ciphertext_size=32,
    secret_size=32,
)
ML_KEM_768 = MLKEM(
    name="mlkem768",
    aliases=("ml-kem-768", "mlkem-768"),
    wire_name="MLKEM768",
    family=Family.PQ,
    level=3,
    registered=Registered(
        oid="2.16.840.1.101.3.4.4.2", family="ML-KEM", parameter_set="768", classical_level=192
    ),
    standard="FIPS 203",
    runs_in=_PQSEC_ONLY,
    public_size=1184,
    ciphertext_size=1088,
    secret_size=32,
    private=mlkem.MLKEM768PrivateKey,
    encapsulation_key=mlkem.MLKEM768PublicKey,
)
ML_KEM_1024 = MLKEM(
    name="mlkem1024",
    aliases=("ml-kem-1024", "mlkem-1024"),
    wire_name="MLKEM1024",
    family=Family.PQ,
    level=5,
    registered=Registered(
        oid="2.16.840.1.101.3.4.4.3", family="ML-KEM", parameter_set="1024", classical_level=256
    ),
    standard="FIPS 203",
    runs_in=_PQSEC_ONLY,
    public_size=1568,
    ciphertext_size=1568,
    secret_size=32,
    private=mlkem.MLKEM1024PrivateKey,
    encapsulation_key=mlkem.MLKEM1024PublicKey,
)


def _hybrid(
    wire_name: str, first: KeyAgreement, second: KeyAgreement, *aliases: str
) -> KeyAgreement:
    """The hybrid of `first` and `second`, with the name that TLS uses (RFC 10024)."""
    return Hybrid(
        name=wire_name.lower(),
        aliases=aliases,
        wire_name=wire_name,
        family=Family.HYBRID,
        level=max(first.level, second.level),
        registered=Registered(
            classical_level=max(each.registered.classical_level for each in (first, second))
        ),
        standard="RFC 10024",
        runs_in=_PQSEC_ONLY,
        public_size=first.public_size + second.public_size,
        ciphertext_size=first.ciphertext_size + second.ciphertext_size,
        secret_size=first.secret_size + second.secret_size,
        first=first,
        second=second,
    )


# RFC 10024: with X25519 ML-KEM comes first, with the NIST curves it comes second.
X25519_ML_KEM_768 = _hybrid(
    "X25519MLKEM768", ML_KEM_768, _X25519, "x25519-ml-kem-768", "x25519-mlkem768"
)
P256_ML_KEM_768 = _hybrid("SecP256r1MLKEM768", ECDH_P256, ML_KEM_768, "p256-ml-kem-768")
P384_ML_KEM_1024 = _hybrid("SecP384r1MLKEM1024", ECDH_P384, ML_KEM_1024, "p384-ml-kem-1024")

KEY_AGREEMENTS = AlgorithmTable[KeyAgreement](
    "key agreement",
    [
        ECDH_P256,
        ECDH_P384,
        DH_MODP_2048_256,
        ML_KEM_768,
        ML_KEM_1024,
        X25519_ML_KEM_768,
        P256_ML_KEM_768,
        P384_ML_KEM_1024,
    ],
    experimental=[x_wing(ML_KEM_768, _X25519)],
    foreign=("pqsec.key_agreements", KeyAgreement),
)
