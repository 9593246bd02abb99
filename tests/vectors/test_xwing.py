"""X-Wing against the draft's vectors, and against the HPKE of `cryptography`."""

import json
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import hashes, hpke
from cryptography.hazmat.primitives.asymmetric import mlkem, x25519
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDF, HKDFExpand

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, Family, profile_named
from pqsec_pki.errors import VerificationError

FILE = Path(__file__).parent / "xwing" / "xwing_draft.json"
CASES = [
    {name: bytes.fromhex(value) for name, value in case.items()}
    for case in json.loads(FILE.read_bytes())
]
ROW = KEY_AGREEMENTS.named("xwing")
SUITE = b"HPKE" + bytes.fromhex("647a00010001")
"""The suite of RFC 9180: X-Wing, HKDF-SHA256, AES-128-GCM."""


@pytest.mark.parametrize("case", CASES)
def test_the_drafts_private_key_gives_its_public_key_and_its_secret(case):
    own = ROW.from_seed(case["sk"])
    assert own.public == case["pk"]
    assert own.decapsulate(case["ct"]) == case["ss"]


@pytest.mark.parametrize("half", [0, -1], ids=["ML-KEM", "X25519"])
def test_another_ciphertext_or_key_gives_another_secret(half):
    """The X25519 halves of both are in the combiner; ML-KEM's are in its own secret."""
    own, other = ROW.generate(), ROW.generate()
    ciphertext, secret = ROW.encapsulate(own.public)
    altered = bytearray(ciphertext)
    altered[half] ^= 1
    assert own.decapsulate(ciphertext) == secret
    assert len({secret, own.decapsulate(bytes(altered)), other.decapsulate(ciphertext)}) == 3


def test_what_is_of_another_size_or_has_no_order_is_refused():
    own = ROW.generate()
    ciphertext, _ = ROW.encapsulate(own.public)
    for public in (own.public[:-1], own.public + b"\0", own.public[:-32] + bytes(32)):
        with pytest.raises(VerificationError):
            ROW.encapsulate(public)
    for wrong in (ciphertext[1:], ciphertext + b"\0", ciphertext[:-32] + bytes(32)):
        with pytest.raises(VerificationError):
            own.decapsulate(wrong)


def extracted(salt, label, value):
    return HKDF.extract(hashes.SHA256(), salt, b"HPKE-v1" + SUITE + label + value)


def expanded(key, label, info, size):
    labelled = size.to_bytes(2) + b"HPKE-v1" + SUITE + label + info
    return HKDFExpand(hashes.SHA256(), size, labelled).derive(key)


def test_what_the_librarys_hpke_seals_opens_with_our_secret():
    own = ROW.generate()
    public = hpke.MLKEM768X25519PublicKey(
        mlkem.MLKEM768PublicKey.from_public_bytes(own.public[:-32]),
        x25519.X25519PublicKey.from_public_bytes(own.public[-32:]),
    )
    suite = hpke.Suite(hpke.KEM.MLKEM768_X25519, hpke.KDF.HKDF_SHA256, hpke.AEAD.AES_128_GCM)
    sealed = suite.encrypt(b"hello", public)
    secret = own.decapsulate(sealed[: ROW.ciphertext_size])
    # RFC 9180, 5.1, in base mode without info.
    context = b"\0" + extracted(b"", b"psk_id_hash", b"") + extracted(b"", b"info_hash", b"")
    master = extracted(secret, b"secret", b"")
    key, nonce = (expanded(master, *each) for each in ((b"key", context, 16),
                                                       (b"base_nonce", context, 12)))  # fmt: skip
    assert AESGCM(key).decrypt(nonce, sealed[ROW.ciphertext_size :], b"") == b"hello"


def test_it_is_used_only_if_named():
    assert ROW in KEY_AGREEMENTS.experimental
    assert ROW not in list(KEY_AGREEMENTS)
    assert ROW not in [profile.key_agreement for profile in PROFILES]
    chosen = profile_named("hybrid").changed({"key_agreement": "x-wing"})
    assert chosen.key_agreement is ROW
    assert chosen.from_names(chosen.to_names()) == chosen
    assert ROW.family is Family.HYBRID
    assert [part.name for part in ROW.parts] == ["mlkem768", "x25519"]
