"""Chains and lists of other tools: pqsec gives the verdict of every stack."""

from datetime import UTC, datetime

import pytest
from cryptography import x509

from pqsec_pki._asn1 import Oid, encode, time_of
from pqsec_pki.certificates import (
    Certificate,
    RevocationList,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.certificates._rdns import same_name
from pqsec_pki.errors import MalformedError, PqsecError
from tests.unit.chains import (
    CASES,
    CN,
    ECDSA,
    GOOD,
    LEAF_NAME,
    NUMERIC,
    PRINTABLE,
    START,
    TRUE,
    UTF8,
    Case,
    ca,
    common,
    constraints,
    crl,
    directory,
    entry,
    extension,
    issuing,
    leaf,
    name,
    sequence_of,
    signed,
    tlv,
    x509_name,
)


def takes(case):
    now = datetime.now(UTC)
    try:
        ca, leaf = map(Certificate.from_der, (case.ca, case.leaf))
        verify_chain(leaf, ca, now=now)
        if case.crl:
            verify_not_revoked(leaf, RevocationList.from_der(case.crl), ca, now=now)
    except PqsecError as error:
        print(error)
        return False
    return True


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_chain_is_judged_as_every_stack_judges_it(case):
    assert takes(case) == case.accepted


def test_values_that_are_no_text_are_the_same_only_in_their_octets():
    identified = ("2.5.4.45", b"\0Z", 0x03)  # a BIT STRING
    assert same_name(name((CN, "X", UTF8), identified), name((CN, "x", UTF8), identified))
    assert not same_name(name(identified), name(("2.5.4.45", b"\0z", 0x03)))
    assert not same_name(name(identified), name(("2.5.4.45", "Z", UTF8)))
    assert same_name(common("12", PRINTABLE), common("12"))
    assert not same_name(common("12", NUMERIC), common("12"))
    assert not same_name(common("1 ", NUMERIC), common("1", NUMERIC))


def test_a_list_of_version_1_is_read_whatever_strings_its_issuer_has():
    parts = [ECDSA, common("*.lab", PRINTABLE), encode(time_of(START))]
    found = RevocationList.from_der(signed(sequence_of(parts), "ca"))
    assert (found.revoked, found.next_update) == ((), None)
    assert list(found.validity_problems(START)) == []


@pytest.mark.parametrize("depth", [3, 30, 5000])
def test_an_extension_with_values_in_values_is_malformed(depth):
    """Some parsers call themselves for each, until the stack is used up."""
    names = directory(LEAF_NAME)
    for _ in range(depth):
        names = tlv(0xA0, names)
    value = extension(sequence_of([names]), oid="2.5.29.35")
    for read, der in ((Certificate.from_der, leaf(value)), (RevocationList.from_der, crl(value))):
        with pytest.raises(MalformedError):
            read(der)


# What pqsec alone refuses (docs/explanation/adr/0043)

FOREIGN = x509.CertificateIssuer([x509_name(LEAF_NAME)])
TWICE = [entry(), entry(extension(x509.CRLReason(x509.ReasonFlags.remove_from_crl)))]
RELATIVE = {
    "relative_name": x509.RelativeDistinguishedName([x509.NameAttribute(Oid(CN), "x")]),
    "only_contains_user_certs": True,
}
STRICTER = {
    "an entry of another issuer": crl(entries=[entry(extension(FOREIGN), serial=8)]),
    "a critical entry of another issuer": crl(entries=[entry(extension(FOREIGN, TRUE), serial=8)]),
    "a removed entry after another": crl(entries=TWICE),
    "a removed entry before another": crl(entries=TWICE[::-1]),
    "a relative name": crl(extension(issuing(**RELATIVE), TRUE)),
}


@pytest.mark.parametrize("words", STRICTER)
def test_a_list_that_readers_could_take_for_another_is_refused(words):
    assert not takes(Case(words, GOOD, ca(), leaf(), STRICTER[words]))


@pytest.mark.parametrize(
    ("base", "accepted"), [(x509.RFC822Name("lab.example"), False), (x509.DNSName("lab"), True)]
)
def test_a_mailbox_in_utf8_is_within_no_constraints_of_mail(base, accepted):
    """OpenSSL compares it."""
    boxed = x509.OtherName(Oid("1.3.6.1.5.5.7.8.9"), b"\x0c\x0da@lab.example")
    issuer = ca(extension(constraints(permitted=[base])))
    made = leaf(extension(x509.SubjectAlternativeName([boxed])))
    assert takes(Case("a mailbox", accepted, issuer, made)) == accepted
