"""A key agreement of this lab, of pqsec's rows: P-384 beside ML-KEM-768."""

from dataclasses import replace

from pqsec_pki.algorithms import KEY_AGREEMENTS

_P384, _ML_KEM = KEY_AGREEMENTS.named("ecdh-p384"), KEY_AGREEMENTS.named("mlkem768")

LAB_KEM = replace(
    KEY_AGREEMENTS.named("secp384r1mlkem1024"),
    name="lab-kem",
    aliases=(),
    wire_name="LabP384MLKEM768",
    level=_ML_KEM.level,
    registered=_P384.registered,
    standard="this lab",
    public_size=_P384.public_size + _ML_KEM.public_size,
    ciphertext_size=_P384.ciphertext_size + _ML_KEM.ciphertext_size,
    second=_ML_KEM,
)
