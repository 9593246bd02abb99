"""Composite ML-DSA against the draft's own vectors."""

import json
from base64 import b64decode
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidSignature

from pqsec_pki.algorithms import SIGNATURES, load_private_key, load_public_key
from pqsec_pki.algorithms.signature import COMPOSITES
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError

FILE = Path(__file__).parent / "composite" / "composite_ml_dsa_draft19.json"
VECTORS = json.loads(FILE.read_bytes())
MESSAGE, CONTEXT = b64decode(VECTORS["m"]), b64decode(VECTORS["ctx"])
CASES = {
    SIGNATURES.named(case["tcId"]): {
        name: b64decode(value) for name, value in case.items() if name != "tcId"
    }
    for case in VECTORS["tests"]
}
each_case = pytest.mark.parametrize(("row", "case"), CASES.items(), ids=[row.name for row in CASES])


def check(row, signature, data=MESSAGE, context=b""):
    handle = row.load_raw_public(CASES[row]["pk"])
    row.check(handle, signature, data, row.identifier, context)


def test_every_composite_has_a_vector():
    assert set(CASES) == set(COMPOSITES)


@each_case
def test_the_signature_verifies(row, case):
    check(row, case["s"])


@each_case
def test_the_signature_with_a_context_verifies(row, case):
    check(row, case["sWithContext"], context=CONTEXT)


@each_case
def test_the_certificate_is_read_and_vouches_for_itself(row, case):
    certificate = Certificate.from_der(case["x5c"])
    key = certificate.public_key
    assert (key.algorithm, key.raw) == (row, case["pk"])
    assert certificate.is_self_issued
    key.verify(certificate.signature, certificate.tbs, certificate.identifier)


@each_case
def test_an_altered_certificate_is_refused(row, case):
    certificate = Certificate.from_der(case["x5c"])
    with pytest.raises(VerificationError, match=f"bad {row.name} signature"):
        certificate.public_key.verify(certificate.signature, certificate.tbs + b"\0")


@each_case
def test_the_private_key_is_read_and_written_byte_for_byte(row, case):
    key = load_private_key(case["sk_pkcs8"])
    assert key.algorithm == row
    assert (key.raw, key.pkcs8) == (case["sk"], case["sk_pkcs8"])
    assert row.private_key(row.load_raw_private(case["sk"])).pkcs8 == case["sk_pkcs8"]


@each_case
def test_the_private_key_belongs_to_the_public_key(row, case):
    public = load_private_key(case["sk_pkcs8"]).public_key
    assert public.raw == case["pk"]
    assert public.spki == Certificate.from_der(case["x5c"]).spki
    assert load_public_key(public.spki).algorithm == row


@each_case
def test_what_the_private_key_signs_verifies(row, case):
    handle = row.load_raw_private(case["sk"])
    check(row, row.sign(handle, MESSAGE))
    check(row, row.sign(handle, MESSAGE, CONTEXT), context=CONTEXT)


@each_case
@pytest.mark.parametrize("field", ["s", "sWithContext"])
def test_the_other_context_is_refused(row, case, field):
    other = CONTEXT if field == "s" else b""
    with pytest.raises(InvalidSignature):
        check(row, case[field], context=other)


@each_case
@pytest.mark.parametrize(
    "place", ["first byte", "last of ML-DSA", "first of the rest", "last byte"]
)
def test_a_signature_altered_in_either_half_is_refused(row, case, place):
    cut = row.ml_dsa.signature_size
    at = {"first byte": 0, "last of ML-DSA": cut - 1, "first of the rest": cut, "last byte": -1}
    signature = bytearray(case["s"])
    signature[at[place]] ^= 1
    with pytest.raises((InvalidSignature, ValueError)):
        check(row, bytes(signature))


@each_case
def test_a_signature_over_another_message_is_refused(row, case):
    with pytest.raises(InvalidSignature):
        check(row, case["s"], data=MESSAGE + b".")


@each_case
@pytest.mark.parametrize("change", [lambda pk: pk[:-1], lambda pk: pk + b"\0", lambda _: b""])
def test_a_public_key_of_another_size_is_refused(row, case, change):
    with pytest.raises(ValueError):
        row.load_raw_public(change(case["pk"]))


@each_case
def test_a_private_key_cut_short_is_refused(row, case):
    with pytest.raises(ValueError):
        row.load_raw_private(case["sk"][:-1])
