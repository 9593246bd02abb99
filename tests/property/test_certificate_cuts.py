"""A certificate that is cut by its lengths is what a strict reader of DER finds in it.

`Certificate.from_der` cuts before the library looks. Here the parts are compared with those that
the types of `_asn1` give, which refuse whatever is not DER.
"""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pqsec_pki._asn1 import (
    Signed,
    SubjectPublicKeyInfo,
    TBSCertificate,
    decode,
    encode,
    whole_bytes,
)
from pqsec_pki.algorithms import load_public_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError
from tests.fuzz import mutation
from tests.interop.der import Der
from tests.longer import examples
from tests.property.test_hostile_input import CAS, LEAVES

cuts = settings(max_examples=examples(300), suppress_health_check=list(HealthCheck))
# cryptography warns of what it will refuse some day.
pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
SEEDS = [each.der for each in (*LEAVES, *(ca.certificate for ca in CAS))]
PARTS = ("tbs", "serial_number", "version", "subject_der", "issuer_der", "spki", "identifier",
         "signature")  # fmt: skip
CONSTRUCTED = 0x20
VERSION = 0xA0


def strictly(der):
    """The parts as the strict types have them; MalformedError for what is not DER."""
    signed = decode(Signed, der, "certificate")
    tbs = decode(TBSCertificate, encode(signed.tbs), "certificate")
    return (
        encode(signed.tbs),
        tbs.serial_number,
        tbs.version + 1,
        encode(tbs.subject),
        encode(tbs.issuer),
        encode(tbs.subject_public_key_info),
        encode(tbs.signature),
        whole_bytes(signed.signature, "signature"),
    )


def compare(der):
    """Whether `der` is taken; then it must be DER, and cut where a strict reader cuts."""
    try:
        found = Certificate.from_der(der)
    except PqsecError:
        return False
    assert tuple(getattr(found, name) for name in PARTS) == strictly(der)
    assert encode(decode(Signed, der, "certificate")) == der
    return True


def test_those_that_are_not_spoilt_are_taken():
    assert all(map(compare, SEEDS))


def long_form(part, zeros=1):
    """The same value, with a longer length than it needs."""
    size = len(part.content).to_bytes(zeros + 2, "big")
    return bytes([part.tag, 0x80 | len(size)]) + size + part.content


def endless(part):
    """The same value in the indefinite form of BER, closed by two zeros."""
    return bytes([part.tag, 0x80]) + part.content + b"\0\0"


def high_tag(part):
    """The same tag number in the form that numbers from 31 on have."""
    tag = part.tag
    return bytes([tag & 0xE0 | 0x1F, tag & 0x1F]) + part[1:]


LIBERTIES = {
    "a length with a zero before it": long_form,
    "a length of 126 octets": lambda part: long_form(part, 124),
    "no length": endless,
    "a tag in the long form": high_tag,
    "a length of more than there is": lambda part: bytes([part.tag, 0x84, 127, 0, 0, 0]),
    "a length beyond all machines": lambda part: bytes([part.tag, 0xFF, *b"\xff" * 127]),
}
"""What BER has and DER has not, and lengths that lie."""
OTHERS = {
    "an octet behind its content": lambda part: Der.of(part.tag, part.content + b"\0"),
    "a value behind its content": lambda part: Der.of(part.tag, part.content + b"\5\0"),
    "a value before its content": lambda part: Der.of(part.tag, b"\5\0" + part.content),
    "half of its content": lambda part: Der.of(part.tag, part.content[: len(part.content) // 2]),
    "nothing in it": lambda part: Der.of(part.tag, b""),
    "no octet of it": lambda part: b"",
    "it is there twice": lambda part: part + part,
    "another tag": lambda part: bytes([part.tag ^ 1]) + part[1:],
    "the tag of a version": lambda part: bytes([VERSION]) + part[1:],
    "a negative number": lambda part: Der.of(part.tag, b"\xff" + part.content[1:]),
    "a number with a zero before it": lambda part: Der.of(part.tag, b"\0" + part.content),
    "a version 1 that is written": lambda part: b"\xa0\3\2\1\0" + part,
    "unused bits": lambda part: Der.of(part.tag, b"\7" + part.content[1:]),
}
"""What may be DER, of something else."""
STRUCTURE = 3
"""Levels below which the parts of a certificate are not cut: names, times, extensions."""


def places(der, depth=STRUCTURE, above=()):
    """Ways to the values of `der`: which part of which."""
    yield above
    if depth and der.tag & CONSTRUCTED:
        for index, part in enumerate(der.parts):
            yield from places(part, depth - 1, (*above, index))


def changed(der, place, change):
    """`der` with the value at `place` changed; the lengths around it are right again."""
    if not place:
        return bytes(change(der))
    parts = list(der.parts)
    parts[place[0]] = changed(parts[place[0]], place[1:], change)
    return Der.of(der.tag, b"".join(parts))


def all_changed(der, change):
    return [changed(der, place, change) for place in places(der)]


@pytest.mark.parametrize("liberty", LIBERTIES)
@pytest.mark.parametrize("der", SEEDS[:2], ids=["first", "second"])
def test_what_is_not_der_is_refused_wherever_it_stands(liberty, der):
    spoilt = all_changed(Der(der), LIBERTIES[liberty])
    assert len(spoilt) > 20
    assert not any(map(compare, spoilt))


@pytest.mark.parametrize("flaw", OTHERS)
@pytest.mark.parametrize("der", SEEDS[:2], ids=["first", "second"])
def test_what_is_changed_is_refused_or_read_as_it_stands(flaw, der):
    for spoilt in all_changed(Der(der), OTHERS[flaw]):
        compare(spoilt)


@pytest.mark.parametrize("octets", [b"", b"\x30", b"\x30\x80", b"\x30\xff", b"\x30\x03\x30\x01"])
def test_the_beginning_of_a_certificate_is_refused(octets):
    assert not compare(octets)


@cuts
@given(st.sampled_from(SEEDS), st.randoms(use_true_random=False))
def test_a_spoilt_certificate_is_refused_or_read_as_it_stands(der, rng):
    compare(mutation.der(der, rng, mutation.blindly(rng)))


@cuts
@given(st.sampled_from(SEEDS), st.integers(0, 260), st.binary(min_size=1, max_size=3))
def test_a_certificate_with_another_head_is_refused_or_read_as_it_stands(der, at, octets):
    compare(der[:at] + octets + der[at + len(octets) :])


KEYS = [each.spki for each in (*LEAVES, *(ca.certificate for ca in CAS))]


@pytest.mark.parametrize("liberty", LIBERTIES)
@pytest.mark.parametrize("spki", KEYS[:4], ids=range(4))
def test_a_key_that_is_not_der_is_refused(liberty, spki):
    for spoilt in all_changed(Der(spki), LIBERTIES[liberty]):
        with pytest.raises(PqsecError):
            load_public_key(spoilt)


@cuts
@given(st.sampled_from(KEYS), st.randoms(use_true_random=False))
def test_a_spoilt_key_is_refused_or_of_the_algorithm_that_it_names(spki, rng):
    spoilt = mutation.der(spki, rng, mutation.blindly(rng))
    try:
        found = load_public_key(spoilt)
    except PqsecError:
        return
    info = decode(SubjectPublicKeyInfo, spoilt, "key")
    assert info.algorithm.algorithm.dotted_string == found.algorithm.key_oid
    assert found.spki == spoilt
