"""Certificates and keys are cut along their lengths: what the lengths can lie about is refused."""

from datetime import UTC, datetime, timedelta

import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from pqsec_pki._asn1 import Oid, bits, encode
from pqsec_pki._der import content, elements, sequence_of
from pqsec_pki.algorithms import SIGNATURES, load_public_key
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.certificates._alternative import _covered_by_certificate
from pqsec_pki.errors import MalformedError

VALUES = [
    bytes.fromhex("020101"),
    bytes.fromhex("0500"),
    bytes.fromhex("048180") + bytes(128),
    bytes.fromhex("04820100") + bytes(256),
]


def sequence(*values):
    inside = b"".join(values)
    return bytes.fromhex("3082") + len(inside).to_bytes(2) + inside


@pytest.fixture(scope="module")
def certificate():
    row, now = SIGNATURES.named("ecdsa-p256"), datetime(2026, 11, 21, tzinfo=UTC)
    return Authority.create("CA", row, now=now, validity=timedelta(days=1)).certificate


@pytest.mark.parametrize("count", range(len(VALUES) + 1))
def test_elements_are_cut_as_they_stand(count):
    assert elements(sequence(*VALUES), count, "list") == VALUES[:count]


def test_content_is_what_follows_the_header():
    assert [content(each) for each in VALUES] == [b"\1", b"", bytes(128), bytes(256)]


@pytest.mark.parametrize(
    "der", [b"", b"\x30", b"\x30\0", b"\x31\3\2\1\1", sequence(), sequence(b"\2"), b"\x30\x84"]
)
def test_too_few_elements_are_refused(der):
    with pytest.raises(MalformedError, match="not a DER list"):
        elements(der, 1, "list")


def test_a_certificate_that_ends_too_soon_is_refused(certificate):
    for end in range(len(certificate.der)):
        with pytest.raises(MalformedError):
            Certificate.from_der(certificate.der[:end])


def test_a_certificate_with_a_length_that_lies_is_refused(certificate):
    """The lengths of the whole, of its content, and of all that stands in that."""
    der, parts = certificate.der, elements(certificate.tbs, 7, "certificate")
    for part in (der, certificate.tbs, *parts):
        at = der.index(part) + 1
        for lie in {der[at] ^ 1, der[at] ^ 0x80, 0, 0x7F, 0x80, 0x84, 0xFF} - {der[at]}:
            with pytest.raises(MalformedError):
                Certificate.from_der(der[:at] + bytes([lie]) + der[at + 1 :])


def test_a_certificate_with_a_length_in_too_many_bytes_is_refused(certificate):
    signature = encode_long(certificate.der[-len(certificate.signature) - 3 :])
    inside = certificate.tbs + certificate.identifier + signature
    with pytest.raises(MalformedError):
        Certificate.from_der(sequence(inside))


def encode_long(value):
    """`value`, whose length is in one byte, with its length in two."""
    return value[:1] + b"\x81" + value[1:]


@pytest.mark.parametrize("row", list(SIGNATURES), ids=lambda row: row.name)
def test_a_bare_rsa_key_is_no_key_of_the_kind_that_stands_in_its_modulus(row):
    """The library would take PKCS#1, which has no OID."""
    oid = encode(Oid(row.key_oid))
    modulus = int.from_bytes(oid + bytes(range(1, 256 - len(oid))) + b"\1")
    bare = rsa.RSAPublicNumbers(65537, modulus).public_key()
    with pytest.raises(MalformedError, match="not a DER SubjectPublicKeyInfo"):
        load_public_key(bare.public_bytes(Encoding.DER, PublicFormat.PKCS1))


VERSION, SERIAL = bytes.fromhex("a003020102"), bytes.fromhex("02020123")
NAME, TIMES, KEY = (sequence_of([bytes.fromhex("0c01") + each]) for each in (b"a", b"b", b"c"))
MARK = sequence_of([encode(Oid("1.2.840.10045.4.3.2"))])
UNIQUE = bytes.fromhex("810300ffff820300eeee")
USAGE, KIND, VALUE = (
    sequence_of([encode(Oid(oid)), encode(encode(bits(bytes(size))))])
    for oid, size in (("2.5.29.15", 1), ("2.5.29.73", 3), ("2.5.29.74", 3309))
)


def to_be_signed(*extensions, mark=b"", unique=b""):
    """A TBSCertificate, whose values need not be valid."""
    inside = sequence_of([sequence_of(extensions)], 0xA3)
    return sequence_of([VERSION, SERIAL, mark, NAME, TIMES, NAME, KEY, unique, inside])


@pytest.mark.parametrize("unique", [b"", UNIQUE])
@pytest.mark.parametrize("place", range(3))
def test_an_alternative_signature_covers_all_but_itself_and_the_mark_of_the_other(unique, place):
    """X.509 (10/2019) 9.8."""
    others = [USAGE, KIND]
    with_value = [*others[:place], VALUE, *others[place:]]
    whole = to_be_signed(*with_value, mark=MARK, unique=unique)
    assert _covered_by_certificate(whole) == to_be_signed(*others, unique=unique)
    before = to_be_signed(*others, mark=MARK, unique=unique)  # when it is made
    assert _covered_by_certificate(before) == to_be_signed(*others, unique=unique)


def test_a_certificate_of_version_1_is_cut_too():
    parts = [SERIAL, MARK, NAME, TIMES, NAME, KEY]
    assert _covered_by_certificate(sequence_of(parts)) == sequence_of([SERIAL, *parts[2:]])
