"""Names with every attribute and string type are spelled as OpenSSL spells them."""

import re

import pytest

from pqsec_pki._asn1 import Oid, encode
from pqsec_pki._assets import asset
from pqsec_pki._der import sequence_of
from pqsec_pki.algorithms import pem
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import parse_subject, same_subject
from tests.unit.chains import BMP, CN, IA5, NUMERIC, PRINTABLE, T61, UTF8, leaf, name, tlv

pytestmark = pytest.mark.interop

OBJECTS = dict(
    line.split() for line in asset("schemas", "object_names.txt").read_text().splitlines()[1:]
)
ARCS = r"(2\.5\.4|0\.9\.2342\.19200300\.100\.1|1\.2\.840\.113549\.1\.9|1\.2\.643\.(3\.131\.1|100)"
ARCS += r"|1\.3\.6\.1\.4\.1\.311|1\.3\.6\.1\.5\.5\.7\.9)\.[0-9.]+"
ATTRIBUTES = [oid for oid in OBJECTS if re.fullmatch(ARCS, oid)]
UNIVERSAL, BITS = 0x1C, 0x03
VALUES = {
    "UTF8String": (UTF8, "é漢 +x".encode()),
    "NumericString": (NUMERIC, b"1 2"),
    "PrintableString": (PRINTABLE, b"a_b*@"),
    "T61String": (T61, b"\xe9,\xc3\xa9"),
    "IA5String": (IA5, b"a@b\xe9"),
    "UniversalString": (UNIVERSAL, "é𐀀".encode("utf-32-be")),
    "BMPString": (BMP, "é漢,".encode("utf-16-be")),
    "empty": (UTF8, b""),
    "hash": (UTF8, b"#0C0161"),
    "control": (UTF8, b"a\x00\x1f\x7f\n"),
}


def spelled(openssl, subject, option, put):
    file = put("cert.pem", pem("CERTIFICATE", leaf(subject=subject)))
    said = openssl("x509", "-noout", "-subject", "-nameopt", option, "-in", file).decode()
    return said.removeprefix("subject=").rstrip("\n")


def agree(openssl, subject, put):
    certificate = Certificate.from_der(leaf(subject=subject))
    theirs = spelled(openssl, subject, "RFC2253,-esc_msb", put)
    assert certificate.subject_name == theirs
    assert certificate.subject_text == spelled(openssl, subject, "compat", put)
    assert same_subject(parse_subject(theirs), parse_subject(certificate.subject_name))


@pytest.mark.parametrize("any_openssl", ["system", "3.5"], indirect=True)
def test_every_attribute_has_the_name_that_openssl_gives_it(any_openssl, put):
    assert len(ATTRIBUTES) > 200
    for part in batched(ATTRIBUTES, 60):
        agree(any_openssl, name(*((oid, "ab", UTF8) for oid in part)), put)


def batched(items, size):
    return (items[at : at + size] for at in range(0, len(items), size))


@pytest.mark.parametrize("any_openssl", ["system", "3.5"], indirect=True)
def test_an_attribute_that_openssl_does_not_know_is_spelled_in_its_form(any_openssl, put):
    subject = name(("1.2.3.4", "ab", UTF8), ("2.5.4.200", "1", PRINTABLE))
    agree(any_openssl, subject, put)
    made = Certificate.from_der(leaf(subject=subject))
    assert made.subject_name == "2.5.4.200=#130131,1.2.3.4=#0C026162"


@pytest.mark.parametrize("any_openssl", ["system", "3.5"], indirect=True)
@pytest.mark.parametrize("kind", VALUES)
@pytest.mark.parametrize("oid", [CN, "1.2.3.4"])
def test_every_string_is_spelled_as_openssl_spells_it(any_openssl, put, kind, oid):
    tag, octets = VALUES[kind]
    agree(any_openssl, name((oid, octets, tag)), put)


def test_a_bit_string_is_spelled_as_openssl_spells_it(openssl, put):
    agree(openssl, name(("2.5.4.45", b"\x00\x5a\xff", BITS)), put)


def test_a_name_with_two_values_in_one_part_is_spelled_as_openssl_spells_it(openssl, put):
    parts = [sequence_of([encode(Oid(oid)), tlv(UTF8, b"a")]) for oid in (CN, "2.5.4.13")]
    agree(openssl, sequence_of([tlv(0x31, b"".join(sorted(parts)))]), put)


@pytest.mark.parametrize("any_openssl", ["system", "3.5"], indirect=True)
def test_the_table_is_that_of_openssl(any_openssl):
    said = any_openssl("list", "-objects").decode()
    theirs = dict(re.findall(r"(?m)^(?!#)(\S+) = (?:.*, )?(\d+(?:\.\d+)+)$", said))
    theirs = {oid: word for word, oid in theirs.items()}
    assert {oid: theirs[oid] for oid in ATTRIBUTES} == {oid: OBJECTS[oid] for oid in ATTRIBUTES}
    if any_openssl.version < (3, 1):
        assert theirs == OBJECTS
