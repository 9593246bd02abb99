"""Certificates and lists that lack parts are malformed, whoever reads them first."""

from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki._der import content, elements, sequence_of
from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Authority, Certificate, RevocationList, revocation_list
from pqsec_pki.errors import MalformedError
from tests.unit import chains

NOW = datetime(2026, 11, 28, tzinfo=UTC)
CA = Authority.create("Lab", SIGNATURES.named("ecdsa-p256"), now=NOW, validity=timedelta(9))
LIST = revocation_list(CA, [], number=1, now=NOW, validity=timedelta(9))


@pytest.mark.parametrize(
    ("read", "der", "needed"),
    [(Certificate.from_der, CA.certificate.der, 7), (RevocationList.from_der, LIST.der, 4)],
    ids=["certificate", "list"],
)
def test_what_lacks_parts_is_malformed(read, der, needed):
    tbs, *signed = elements(der, None, "DER")
    values = elements(tbs, None, "DER")
    for count in range(needed):
        with pytest.raises(MalformedError):
            read(sequence_of([sequence_of(values[:count]), *signed]))


def longer(der):
    """The same value with its length in more octets than it needs, which is BER."""
    octets = content(der)
    return der[:1] + b"\x83" + len(octets).to_bytes(3) + octets


def at(path, der, change):
    """`der` with what is at the path of positions in it changed."""
    if not path:
        return change(der)
    values = elements(b"\x30" + der[1:], None, "DER")
    values[path[0]] = at(path[1:], values[path[0]], change)
    return sequence_of(values, der[0])


@pytest.mark.parametrize("path", [(), (0,), (0, -1), (0, -1, 0), (0, -1, 0, 0)], ids=len)
@pytest.mark.parametrize(
    ("read", "der"),
    [(Certificate.from_der, CA.certificate.der), (RevocationList.from_der, LIST.der)],
    ids=["certificate", "list"],
)
def test_what_has_a_length_in_more_octets_than_it_needs_is_malformed(read, der, path):
    read(at(path, der, lambda part: part))
    with pytest.raises(MalformedError):
        read(at(path, der, longer))


def test_an_extension_without_a_value_is_malformed():
    tbs, *signed = elements(LIST.der, None, "DER")
    *values, extensions = elements(tbs, None, "DER")
    for parts in ([], [bytes.fromhex("0603551d1c")]):
        listed = sequence_of([sequence_of([sequence_of(parts)])], extensions[0])
        with pytest.raises(MalformedError):
            RevocationList.from_der(sequence_of([sequence_of([*values, listed]), *signed]))


@pytest.mark.parametrize("octets", ["308100", "308103010100", "300401810100"])
def test_a_value_of_an_extension_that_is_not_der_is_malformed(octets):
    Certificate.from_der(chains.leaf(chains.extension(b"\x30\x00", oid="2.5.29.19")))
    with pytest.raises(MalformedError):
        Certificate.from_der(chains.leaf(chains.extension(bytes.fromhex(octets), oid="2.5.29.19")))
