"""Signed documents: what verifies, and each flaw that must be refused."""

import base64
import re
import shutil
import subprocess
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki._asn1 import (
    CMSAlgorithmProtection,
    ContentInfo,
    EncapsulatedContentInfo,
    IssuerAndSerialNumber,
    Oid,
    SetOf,
    algorithm,
    attribute,
    decode,
    encode,
    raw,
    time_of,
)
from pqsec_pki.algorithms import PROFILES, SIGNATURES, Family, digest_of, private_key_pem
from pqsec_pki.certificates import Authority, Certificate, common_name
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.smime import (
    AmbiguousError,
    Require,
    Signer,
    document_in,
    is_signed,
    joined,
    parts_of,
    sign,
    signers_in,
    verify,
)
from pqsec_pki.smime._ber import MAX_CHILDREN, MAX_DEPTH, MAX_SIZE, limit_values, to_der
from pqsec_pki.smime._mime import MAX_MESSAGE, content_of
from pqsec_pki.smime._signer_info import COUNTERSIGNATURE, make
from pqsec_pki.smime.document import MAX_CARRIED, MAX_CARRIED_VALUES, MAX_COUNTERSIGNATURES
from tests.unit import signers

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
YEAR = timedelta(days=365)
DOCUMENT = Governance.protected(DomainSet.of(0)).to_xml()
ROWS = [row for row in SIGNATURES if "3072" not in row.name and "4096" not in row.name]
DATA, SIGNED_DATA = "1.2.840.113549.1.7.1", "1.2.840.113549.1.7.2"
CONTENT_TYPE, MESSAGE_DIGEST, SIGNING_TIME, PROTECTION = (
    "1.2.840.113549.1.9.3",
    "1.2.840.113549.1.9.4",
    "1.2.840.113549.1.9.5",
    "1.2.840.113549.1.9.52",
)
SHA1, SHA256, SHA384, SHA512 = (
    "1.3.14.3.2.26",
    "2.16.840.1.101.3.4.2.1",
    "2.16.840.1.101.3.4.2.2",
    "2.16.840.1.101.3.4.2.3",
)

each_row = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)


def signer_of(name, algorithm_name):
    ca = Authority.create(name, SIGNATURES.named(algorithm_name), now=NOW, validity=YEAR)
    return Signer(ca.certificate, ca.key)


@dataclass(frozen=True)
class Lab:
    """A permissions CA, its countersigner, and somebody else's of the same names."""

    main: Signer
    counter: Signer
    mallory: Signer
    mallorys_counter: Signer

    def sign(self, document=DOCUMENT, **options):
        return sign(document, self.main, **({"now": NOW} | options))

    def countersigned(self, document=DOCUMENT, **options):
        return self.sign(document, countersigner=self.counter, **options)

    def verify(self, message, require=Require.ANY, *, pinned=True):
        alternative = self.counter.certificate if pinned else None
        return verify(message, self.main.certificate, alternative_ca=alternative, require=require)

    def problems(self, message, require=Require.ANY, *, pinned=True):
        with pytest.raises(VerificationError) as caught:
            self.verify(message, require, pinned=pinned)
        return caught.value.lines


@pytest.fixture(scope="module")
def lab():
    """A lab with today's keys."""
    return Lab(
        main=signer_of("Permissions CA", "p256"),
        counter=signer_of("Permissions CA ml-dsa-65", "ml-dsa-65"),
        mallory=signer_of("Permissions CA", "p256"),
        mallorys_counter=signer_of("Permissions CA ml-dsa-65", "ml-dsa-65"),
    )


# Taking files apart and putting them together otherwise


def crlf(document):
    return re.sub(rb"\r?\n", b"\r\n", document)


def cms_of(message):
    """The CMS structure in a signed file, read independently of the package."""
    [text] = re.findall(rb'filename="smime.p7s"\n\n(.*?)\n\n--', message, re.DOTALL)
    return base64.b64decode(text)


def with_cms(message, der):
    old = base64.encodebytes(cms_of(message)).replace(b"\n", b"")
    text = message.replace(b"\n", b"\0")
    start = text.index(b'filename="smime.p7s"\0\0') + len(b'filename="smime.p7s"\0\0')
    end = text.index(b"\0\0--", start)
    assert message[start:end].replace(b"\n", b"") == old
    return message[:start] + base64.encodebytes(der).rstrip() + message[end:]


def data_of(message):
    return decode(ContentInfo, cms_of(message), "CMS").content


def with_data(message, **changes):
    """`message` with other fields in its SignedData."""
    data = data_of(message)
    for name, value in changes.items():
        setattr(data, name, value)
    return with_cms(message, encode(ContentInfo(content_type=Oid(SIGNED_DATA), content=data)))


def info_of(message):
    [info] = data_of(message).signer_infos.as_list()
    return info


def with_info(message, **changes):
    """`message` with other fields in its SignerInfo, which is not signed again."""
    info = info_of(message)
    for name, value in changes.items():
        setattr(info, name, value)
    return with_data(message, signer_infos=SetOf([info]))


def signed_with(lab, attributes, *, digest=SHA256, document=DOCUMENT, signer=None):
    """A file whose signer signed just these attributes."""
    signer, attributes = signer or lab.main, list(attributes)
    info = make(signer, content_of(document), now=NOW)
    info.digest_algorithm = algorithm(digest)
    info.signed_attributes = sorted(attributes, key=encode) or None
    info.signature = signer.key.sign(encode(SetOf(attributes)))
    return with_data(sign(document, signer, now=NOW), signer_infos=SetOf([info]))


def attributes_over(document=DOCUMENT, digest=SHA256):
    return {
        CONTENT_TYPE: attribute(CONTENT_TYPE, encode(Oid(DATA))),
        MESSAGE_DIGEST: attribute(
            MESSAGE_DIGEST, encode(digest_of(digest).of(content_of(document)))
        ),
        SIGNING_TIME: attribute(SIGNING_TIME, encode(time_of(NOW))),
    }


def with_counters(message, *counters):
    """`message` with these countersignatures and no others."""
    attributes = [attribute(COUNTERSIGNATURE, encode(counter)) for counter in counters]
    return with_info(message, unsigned_attributes=attributes or None)


def counter_of(message):
    [one] = info_of(message).unsigned_attributes
    [value] = one.values.as_list()
    return value


# What holds


@each_row
def test_a_document_signed_with_every_kind_of_key_verifies(row):
    signer = signer_of("CA", row.name)
    verified = verify(sign(DOCUMENT, signer, now=NOW), signer.certificate)
    [found] = verified.signatures
    assert (found.algorithm, found.countersignature, found.signed_at) == (row, False, NOW)
    assert verified.document == crlf(DOCUMENT)
    assert verified.unchecked == 0


@each_row
def test_an_altered_document_is_refused_with_every_kind_of_key(row):
    signer = signer_of("CA", row.name)
    altered = sign(DOCUMENT, signer, now=NOW).replace(b"ENCRYPT", b"encrypt", 1)
    with pytest.raises(VerificationError, match="the content was changed after signing"):
        verify(altered, signer.certificate)


@each_row
def test_a_document_by_another_key_is_refused_with_every_kind_of_key(row):
    signer, mallory = signer_of("CA", row.name), signer_of("CA", row.name)
    forged = Signer(signer.certificate, mallory.key)
    with pytest.raises(VerificationError, match=f"bad {row.name} signature"):
        verify(sign(DOCUMENT, forged, now=NOW), signer.certificate)


def test_a_countersigned_document_verifies(lab):
    verified = lab.verify(lab.countersigned(), Require.BOTH)
    families = [each.algorithm.family for each in verified.signatures]
    assert families == [Family.CLASSICAL, Family.PQ]
    assert [each.countersignature for each in verified.signatures] == [False, True]
    assert {each.signed_at for each in verified.signatures} == {NOW}


def test_a_countersignature_that_cannot_be_checked_is_counted(lab):
    verified = lab.verify(lab.countersigned(), pinned=False)
    assert (len(verified.signatures), verified.unchecked) == (1, 1)


@pytest.mark.parametrize("embedded", [True, False])
def test_the_signers_certificate_is_embedded_or_not(lab, embedded):
    message = lab.sign(embed_certificate=embedded)
    certificates = data_of(message).certificates
    expected = [lab.main.certificate.der] if embedded else None
    assert (certificates and [encode(each) for each in certificates]) == expected
    lab.verify(message)


DOCUMENTS = {
    "LF": DOCUMENT,
    "CRLF": crlf(DOCUMENT),
    "mixed": DOCUMENT.replace(b"\n", b"\r\n", 3),
    "no final newline": DOCUMENT.rstrip(),
    "three final newlines": DOCUMENT + b"\n\n",
    "empty": b"",
    "one newline": b"\n",
    "blank line first": b"\n\n" + DOCUMENT,
    "boundary-like lines": b"<dds>\n--\n----\n------ABC--\n-- x --\n</dds>\n",
    "MIME inside": b"Content-Type: multipart/signed; boundary=x\n\n--x\n--x--\n",
    "a line like a header": b"MIME-Version: 1.0\n",
    "a long line": b"<!-- " + b"x" * 5000 + b" -->\n",
    "control and high bytes": bytes(range(1, 256)).replace(b"\r", b""),
}


@pytest.mark.parametrize("document", DOCUMENTS.values(), ids=DOCUMENTS)
def test_a_document_of_any_text_is_signed_and_comes_out_with_crlf(lab, document):
    message = lab.countersigned(document)
    assert lab.verify(message, Require.BOTH).document == crlf(document)
    assert document_in(message) == crlf(document)


@pytest.mark.parametrize("document", DOCUMENTS.values(), ids=DOCUMENTS)
def test_the_file_may_be_stored_with_lf_or_crlf(lab, document):
    message = lab.sign(document)
    assert b"\r" not in message
    assert lab.verify(crlf(message)).document == crlf(document)


@pytest.mark.parametrize("document", [b"a\r\r\nb\n", b"a\r", b"\r", b"a\rb\n", b"\r\n\r"])
def test_a_document_with_lone_carriage_returns_verifies(lab, document):
    # XML 1.0 2.11: they end lines too.
    assert lab.verify(lab.sign(document)).document == re.sub(rb"\r\n?|\n", b"\r\n", document)


def test_a_signed_file_is_told_from_xml(lab):
    assert is_signed(lab.sign())
    assert is_signed(crlf(lab.sign()))
    assert not is_signed(DOCUMENT)
    assert not is_signed(b"")


def test_the_file_names_the_digest(lab):
    assert b'micalg="sha-256"' in lab.sign()
    assert b'micalg="sha-512"' in sign(DOCUMENT, lab.counter, now=NOW)


def test_the_boundary_is_the_texts_own(lab):
    texts = (DOCUMENT, DOCUMENT, DOCUMENT + b" ")
    first, again, other = (boundary_of(lab.sign(text)) for text in texts)
    assert first == again != other


def test_a_document_with_a_nul_is_not_signed(lab):
    # Stacks that keep documents as C strings would read less than was signed.
    with pytest.raises(MalformedError, match="NUL"):
        lab.sign(b"<dds/>\n\0")


# What is required


MATRIX = {
    # main key, countersigned: what is met
    ("ecdsa-p256", False): {Require.ANY, Require.CLASSICAL},
    ("ecdsa-p256", True): {Require.ANY, Require.CLASSICAL, Require.PQ, Require.BOTH},
    ("ml-dsa-65", False): {Require.ANY, Require.PQ},
    ("ml-dsa-65", True): {Require.ANY, Require.PQ},
    ("ml-dsa-87", False): {Require.ANY, Require.PQ},
    ("mldsa65-ecdsa-p256-sha512", False): set(Require),
    ("rsa-2048", False): {Require.ANY, Require.CLASSICAL},
}


@pytest.mark.parametrize("require", Require)
@pytest.mark.parametrize(("key", "countersigned"), MATRIX)
def test_what_is_required_must_be_there(lab, key, countersigned, require):
    main = signer_of("CA", key)
    counter = lab.counter if countersigned else None
    message = sign(DOCUMENT, main, countersigner=counter, now=NOW)
    options = {"alternative_ca": lab.counter.certificate, "require": require}
    if require in MATRIX[key, countersigned]:
        verify(message, main.certificate, **options)
    else:
        with pytest.raises(VerificationError, match="and one is required"):
            verify(message, main.certificate, **options)


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
def test_every_profile_signs_what_it_promises(profile, lab):
    main = signer_of("CA", profile.permissions_key.name)
    counter = lab.counter if profile.alternative_key else None
    message = sign(DOCUMENT, main, countersigner=counter, now=NOW)
    required = {
        "transition": Require.BOTH,
        "hybrid": Require.BOTH,
        "classical": Require.CLASSICAL,
    }.get(profile.name, Require.PQ)
    verified = verify(
        message, main.certificate, alternative_ca=lab.counter.certificate, require=required
    )
    assert len(verified.signatures) == (2 if counter else 1)


@pytest.mark.parametrize("require", [Require.PQ, Require.BOTH])
def test_a_countersignature_that_cannot_be_checked_does_not_count(lab, require):
    [problem] = lab.problems(lab.countersigned(), require, pinned=False)
    assert (
        problem == "there is no post-quantum signature that could be checked, and one is required"
    )


# Countersignatures


@pytest.mark.parametrize("require", [Require.PQ, Require.BOTH])
def test_a_countersignature_that_was_stripped_is_missed(lab, require):
    stripped = with_counters(lab.countersigned())
    lab.verify(stripped)
    [problem] = lab.problems(stripped, require)
    assert "no post-quantum signature" in problem


def test_a_pinned_countersignature_may_not_be_missing(lab):
    def check(message):
        ca, counter = lab.main.certificate, lab.counter.certificate
        return verify(message, ca, alternative_ca=counter, require=Require.ANY, pinned=True)

    assert len(check(lab.countersigned()).signatures) == 2
    with pytest.raises(VerificationError, match="there is no countersignature by"):
        check(lab.sign())


def test_an_altered_countersignature_is_refused_even_where_none_is_required(lab):
    message = lab.countersigned()
    der = bytearray(encode(counter_of(message)))
    der[-1] ^= 1
    altered = with_info(message, unsigned_attributes=[attribute(COUNTERSIGNATURE, bytes(der))])
    assert lab.problems(altered) == ("the countersignature: bad ml-dsa-65 signature",)


def test_a_countersignature_by_another_key_is_refused(lab):
    forged = Signer(lab.counter.certificate, lab.mallorys_counter.key)
    found = lab.problems(lab.sign(countersigner=forged))
    assert found == ("the countersignature: bad ml-dsa-65 signature",)


def test_a_countersignature_by_another_authority_does_not_count(lab):
    message = lab.sign(countersigner=lab.mallorys_counter)
    assert lab.verify(message).unchecked == 1
    [problem] = lab.problems(message, Require.PQ)
    assert "no post-quantum signature" in problem


def test_a_countersignature_moved_from_another_document_is_refused(lab):
    other = lab.countersigned(b"<dds>another document</dds>\n")
    moved = with_info(lab.sign(), unsigned_attributes=info_of(other).unsigned_attributes)
    assert lab.problems(moved) == ("the countersignature: the content was changed after signing",)


def test_very_many_countersignatures_are_refused(lab):
    message = lab.countersigned()
    counter = counter_of(message)
    assert lab.verify(with_counters(message, *[counter] * MAX_COUNTERSIGNATURES))
    [problem] = lab.problems(with_counters(message, *[counter] * (MAX_COUNTERSIGNATURES + 1)))
    assert problem == f"more than {MAX_COUNTERSIGNATURES} countersignatures"


def test_a_countersignature_with_a_content_type_is_refused(lab):
    # A signature over data of the attacker's choice would fit here otherwise.
    message = lab.sign()
    counter = make(lab.counter, info_of(message).signature, now=NOW)
    [problem] = lab.problems(with_counters(message, counter))
    assert "a signature taken from elsewhere" in problem


def test_a_signature_without_a_content_type_is_no_document_signature(lab):
    # A countersignature of the same key would fit here otherwise.
    message = lab.sign()
    info = make(lab.main, content_of(DOCUMENT), now=NOW, counter=True)
    [problem] = lab.problems(with_data(message, signer_infos=SetOf([info])))
    assert problem == "the signature does not say that it covers plain data"


def test_one_bad_countersignature_beside_a_good_one_is_refused(lab):
    message = lab.sign()
    good = make(lab.counter, info_of(message).signature, now=NOW, counter=True)
    bad = make(lab.counter, b"another signature", now=NOW, counter=True)
    lab.verify(with_counters(message, good), Require.BOTH)
    assert lab.problems(with_counters(message, good, bad))


def test_a_countersignature_that_cannot_be_read_is_refused(lab):
    broken = [attribute(COUNTERSIGNATURE, b"\x05\x00")]
    [problem] = lab.problems(with_info(lab.sign(), unsigned_attributes=broken))
    assert "not a DER countersignature" in problem


def test_an_unknown_unsigned_attribute_is_passed_over(lab):
    other = [attribute("1.3.6.1.4.1.99999.1", b"\x05\x00")]
    lab.verify(with_info(lab.sign(), unsigned_attributes=other))


# Who signed


def test_another_authority_of_the_same_name_is_refused(lab):
    [problem] = lab.problems(sign(DOCUMENT, lab.mallory, now=NOW))
    assert problem == "not signed by CN=Permissions CA but by another certificate"


def test_a_look_alike_of_the_pinned_certificate_is_not_trusted(lab):
    # The same issuer and serial number, another key: an embedded certificate to fall for.
    look_alike = lab.main.certificate.der.replace(
        lab.main.certificate.spki, lab.mallory.certificate.spki
    )
    assert look_alike != lab.main.certificate.der
    forged = sign(DOCUMENT, Signer(lab.main.certificate, lab.mallory.key), now=NOW)
    message = with_data(forged, certificates=[raw(look_alike)])
    assert lab.problems(message) == ("bad ecdsa-p256 signature",)


def test_the_embedded_certificate_is_not_looked_at(lab):
    lab.verify(with_data(lab.sign(), certificates=[raw(lab.mallory.certificate.der)]))
    lab.verify(with_data(lab.sign(), certificates=None))


def test_a_signer_named_by_its_key_identifier_verifies(lab):
    identifier = lab.main.certificate.subject_key_identifier
    lab.verify(with_info(lab.sign(), sid=identifier, version=3))
    [problem] = lab.problems(with_info(lab.sign(), sid=b"\0" * 20, version=3))
    assert "by another certificate" in problem


def test_a_signer_named_by_another_serial_number_is_refused(lab):
    sid = IssuerAndSerialNumber(issuer=raw(lab.main.certificate.issuer_der), serial_number=7)
    [problem] = lab.problems(with_info(lab.sign(), sid=sid))
    assert "by another certificate" in problem


def test_a_signer_named_by_another_issuer_is_refused(lab):
    issuer, number = raw(common_name("Other CA")), lab.main.certificate.serial_number
    sid = IssuerAndSerialNumber(issuer=issuer, serial_number=number)
    [problem] = lab.problems(with_info(lab.sign(), sid=sid))
    assert "by another certificate" in problem


@pytest.mark.parametrize("case", signers.CASES, ids=str)
def test_a_signer_is_named_as_openssl_compares_names(case):
    ca = Certificate.from_der(case.ca)
    with nullcontext() if case.accepted else pytest.raises((VerificationError, MalformedError)):
        assert verify(case.message, ca).document == document_in(case.message)


def test_a_signer_with_a_name_that_cryptography_refuses_is_listed():
    [case] = (each for each in signers.CASES if str(each) == "a printable lab_ca*")
    [signer] = signers_in(case.message).signers
    assert signer.issuer == "CN=lab_ca*"


def test_two_signers_are_refused(lab):
    # As every stack was measured to do, in any order.
    message = lab.sign()
    second = make(lab.counter, content_of(DOCUMENT), now=NOW)
    infos = [info_of(message), second]
    [problem] = lab.problems(with_data(message, signer_infos=SetOf(infos)))
    assert problem == "2 signers; DDS stacks take exactly one"


def test_no_signer_is_refused(lab):
    [problem] = lab.problems(with_data(lab.sign(), signer_infos=SetOf([])))
    assert problem == "0 signers; DDS stacks take exactly one"


# Signed attributes


def test_attributes_signed_by_hand_verify(lab):
    lab.verify(signed_with(lab, attributes_over().values()))


def test_a_number_is_signed_with_the_document(lab):
    """Robots order documents by it."""
    for number in (None, 7):
        [found] = lab.verify(lab.sign(number=number)).signatures
        assert found.number == number


def test_a_signing_time_may_be_missing(lab):
    attributes = attributes_over()
    del attributes[SIGNING_TIME]
    [found] = lab.verify(signed_with(lab, attributes.values())).signatures
    assert found.signed_at is None


@pytest.mark.parametrize("values", [0, 2])
def test_a_signing_time_without_just_one_value_says_nothing(lab, values):
    attributes = attributes_over()
    time = attributes[SIGNING_TIME]
    time.values = SetOf([*time.values.as_list(), raw(encode(time_of(NOW + YEAR)))][:values])
    [listed] = signers_in(signed_with(lab, attributes.values())).signers
    assert listed.signed_at is None


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        (MESSAGE_DIGEST, "does not name the content's digest"),
        (CONTENT_TYPE, "does not say that it covers plain data"),
    ],
)
def test_a_missing_signed_attribute_is_refused(lab, missing, words):
    attributes = attributes_over()
    del attributes[missing]
    [problem] = lab.problems(signed_with(lab, attributes.values()))
    assert words in problem


@pytest.mark.parametrize("twice", [CONTENT_TYPE, MESSAGE_DIGEST, SIGNING_TIME])
def test_a_repeated_signed_attribute_is_refused(lab, twice):
    attributes = [*attributes_over().values()]
    other = attributes_over(b"another document")[twice]
    [problem] = lab.problems(signed_with(lab, [*attributes, other]))
    assert problem == f"signed attribute {twice} is missing or repeated"


@pytest.mark.parametrize("values", [0, 2])
def test_a_signed_attribute_without_just_one_value_is_refused(lab, values):
    attributes = attributes_over()
    digest = attributes[MESSAGE_DIGEST]
    digest.values = SetOf([*digest.values.as_list(), raw(b"\x04\x01\x00")][:values])
    [problem] = lab.problems(signed_with(lab, attributes.values()))
    assert "is missing or repeated" in problem


def test_a_signature_without_signed_attributes_is_refused(lab):
    info = make(lab.main, content_of(DOCUMENT), now=NOW)
    info.signed_attributes = None
    info.signature = lab.main.key.sign(content_of(DOCUMENT))
    [problem] = lab.problems(with_data(lab.sign(), signer_infos=SetOf([info])))
    assert problem == "the signature has no signed attributes"


def test_attributes_cannot_pass_for_content(lab):
    # The same bytes, once as attributes and once as a document (RFC 5652 11, EUF-CMA).
    info = info_of(lab.sign())
    attributes = encode(SetOf(list(info.signed_attributes)))
    stolen = with_info(lab.sign(attributes), signature=info.signature)
    assert "bad ecdsa-p256 signature" in lab.problems(stolen)


def test_another_content_type_is_refused(lab):
    attributes = attributes_over()
    attributes[CONTENT_TYPE] = attribute(CONTENT_TYPE, encode(Oid(SIGNED_DATA)))
    [problem] = lab.problems(signed_with(lab, attributes.values()))
    assert problem == "the signature does not say that it covers plain data"


@pytest.mark.parametrize("value", [b"\x05\x00", b"\x04\x00", b"\x0c\x01a"])
def test_a_digest_that_is_none_is_refused(lab, value):
    attributes = attributes_over()
    attributes[MESSAGE_DIGEST] = attribute(MESSAGE_DIGEST, value)
    assert lab.problems(signed_with(lab, attributes.values()))


@pytest.mark.parametrize("value", [b"\x05\x00", b"\x17\x0d000000000000Z"])
def test_a_signing_time_that_is_none_is_refused(lab, value):
    attributes = attributes_over()
    attributes[SIGNING_TIME] = attribute(SIGNING_TIME, value)
    [problem] = lab.problems(signed_with(lab, attributes.values()))
    assert "signing time" in problem


def test_an_altered_signed_attribute_is_refused(lab):
    info = info_of(lab.sign())
    late = attribute(SIGNING_TIME, encode(time_of(NOW + YEAR)))
    kept = [each for each in info.signed_attributes if each.type.dotted_string != SIGNING_TIME]
    altered = with_info(lab.sign(), signed_attributes=[*kept, late], signature=info.signature)
    assert lab.problems(altered)


# Algorithms


@pytest.mark.parametrize("name", ["ml-dsa-44", "ml-dsa-65", "ml-dsa-87", "ecdsa-p256", "rsa-2048"])
@pytest.mark.parametrize("digest", [SHA1, SHA256, SHA384, SHA512])
def test_a_digest_weaker_than_the_key_is_refused(lab, name, digest):
    signer = signer_of("CA", name)
    row = signer.key.algorithm
    if digest == SHA1:
        attributes = attributes_over().values()
    else:
        attributes = attributes_over(digest=digest).values()
    message = signed_with(lab, attributes, digest=digest, signer=signer)
    if digest in {each.oid for each in row.cms_digests}:
        verify(message, signer.certificate)
    else:
        with pytest.raises(VerificationError, match=r"too weak|no longer safe"):
            verify(message, signer.certificate)


def test_a_digest_may_have_null_for_its_parameters(lab):
    marked = algorithm(SHA256, null=True)
    message = signed_with(lab, attributes_over().values())
    lab.verify(with_info(message, digest_algorithm=marked))


def test_a_digest_with_other_parameters_is_refused(lab):
    marked = algorithm(SHA256)
    marked.parameters = raw(b"\x04\x00")
    message = signed_with(lab, attributes_over().values())
    [problem] = lab.problems(with_info(message, digest_algorithm=marked))
    assert problem == "the digest has parameters"


def test_an_exchanged_digest_algorithm_is_refused(lab):
    [*found] = lab.problems(with_info(lab.sign(), digest_algorithm=algorithm(SHA512)))
    assert "the signature's algorithms were exchanged" in found
    assert "the content was changed after signing" in found


@pytest.mark.parametrize(
    "identifier",
    [algorithm("1.2.840.10045.4.3.4"), algorithm("1.2.840.10045.4.3.2", null=True),
     algorithm("2.16.840.1.101.3.4.3.18"), algorithm("1.2.840.10045.4.1")],
    ids=["SHA-512", "with NULL", "ML-DSA-65", "SHA-1"],
)  # fmt: skip
def test_an_exchanged_signature_algorithm_is_refused(lab, identifier):
    found = lab.problems(with_info(lab.sign(), signature_algorithm=identifier))
    assert found[0] == "the signature's algorithms were exchanged"
    assert len(found) == 2


def test_an_ml_dsa_signature_marked_with_parameters_is_refused(lab):
    message = sign(DOCUMENT, lab.counter, now=NOW)
    marked = with_info(message, signature_algorithm=algorithm("2.16.840.1.101.3.4.3.18", null=True))
    with pytest.raises(VerificationError, match="does not fit the signer's ml-dsa-65 key"):
        verify(marked, lab.counter.certificate)


def test_a_false_algorithm_protection_is_refused(lab):
    attributes = attributes_over()
    other = CMSAlgorithmProtection(
        digest_algorithm=algorithm(SHA512), signature_algorithm=algorithm("1.2.840.10045.4.3.2")
    )
    attributes[PROTECTION] = attribute(PROTECTION, encode(other))
    [problem] = lab.problems(signed_with(lab, attributes.values()))
    assert problem == "the signature's algorithms were exchanged"


def test_an_rsa_signature_may_be_marked_as_plain_rsa():
    # RFC 3370 3.2, as OpenSSL writes it.
    signer = signer_of("CA", "rsa-2048")
    message = signed_with(None, attributes_over().values(), signer=signer)
    plain = with_info(message, signature_algorithm=algorithm("1.2.840.113549.1.1.1", null=True))
    verify(plain, signer.certificate)
    weak = with_info(plain, digest_algorithm=algorithm("2.16.840.1.101.3.4.2.8"))
    with pytest.raises(VerificationError):
        verify(weak, signer.certificate)


# The CMS structure


def test_content_inside_the_structure_is_refused(lab):
    inside = EncapsulatedContentInfo(content_type=Oid(DATA), content=content_of(DOCUMENT))
    [problem] = lab.problems(with_data(lab.sign(), encapsulated_content=inside))
    assert problem == "the CMS structure has content of its own"


def test_a_structure_about_something_else_is_refused(lab):
    other = EncapsulatedContentInfo(content_type=Oid(SIGNED_DATA), content=None)
    [problem] = lab.problems(with_data(lab.sign(), encapsulated_content=other))
    assert problem == "the CMS structure is not about plain data"


def test_another_kind_of_structure_is_refused(lab):
    data = data_of(lab.sign())
    other = encode(ContentInfo(content_type=Oid("1.2.840.113549.1.7.3"), content=data))
    [problem] = lab.problems(with_cms(lab.sign(), other))
    assert problem == "not a CMS SignedData structure"


def indefinite(der):
    """`der` as OpenSSL and BouncyCastle stream it: no lengths on constructed values."""
    pieces, rest = [], der
    while rest:
        tag, size, head = rest[0], rest[1], 2
        if size & 0x80:
            head += size & 0x7F
            size = int.from_bytes(rest[2:head], "big")
        body, rest = rest[head : head + size], rest[head + size :]
        if tag & 0x20:
            pieces.append(bytes([tag, 0x80]) + indefinite(body) + b"\0\0")
        else:
            pieces.append(bytes([tag]) + rest_of(body))
    return b"".join(pieces)


def rest_of(body):
    """A length of four bytes, longer than needed, and the body."""
    return b"\x84" + len(body).to_bytes(4, "big") + body


@pytest.mark.parametrize("countersigned", [True, False])
def test_ber_with_indefinite_lengths_is_read(lab, countersigned):
    message = lab.countersigned() if countersigned else lab.sign()
    streamed = indefinite(cms_of(message))
    assert streamed != cms_of(message)
    assert to_der(streamed) == cms_of(message)
    require = Require.BOTH if countersigned else Require.ANY
    lab.verify(with_cms(message, streamed), require)


def test_an_octet_string_in_pieces_is_joined():
    assert to_der(bytes.fromhex("2480 0402abcd 0401ef 0000")) == bytes.fromhex("0403abcdef")
    assert to_der(bytes.fromhex("2404 2402 0400")) == bytes.fromhex("0400")


def test_a_set_is_put_in_order():
    assert to_der(bytes.fromhex("3180 020102 020101 0000")) == bytes.fromhex("3106020101020102")


@pytest.mark.parametrize(
    ("ber", "words"),
    [
        ("", "cut short"),
        ("30", "cut short"),
        ("3003 0500", "past its end"),
        ("3080 0500", "does not end"),
        ("0480 0000", "an indefinite length where none can be"),
        ("3085 0000000000", "a length in the CMS structure is invalid"),
        ("3084 7fffffff 00", "past its end"),
        ("30ff", "a length in the CMS structure is invalid"),
        ("1f8101 00", "a tag that CMS does not have"),
        ("0500 00", "bytes after the end"),
        ("2403 020100", "broken octet string"),
        ("3805 1803313233", "a value in pieces"),
        ("2c03 0c0161", "a value in pieces"),
        ("0600", "broken object identifier"),
        ("3003 0601f1", "broken object identifier"),
        ("0603 2a8001", "broken object identifier"),
        ("0501 00", "broken null"),
        ("3103 050161", "broken null"),
        ("0100", "broken boolean"),
        ("0102 0000", "broken boolean"),
        ("0200", "broken integer"),
        ("0202 007f", "broken integer"),
        ("0202 ff80", "broken integer"),
        ("0300", "broken bit string"),
        ("0302 0800", "broken bit string"),
        ("0301 01", "broken bit string"),
        ("1000", "sequence or set that is not constructed"),
        ("3104 11020500", "sequence or set that is not constructed"),
    ],
)
def test_broken_ber_is_refused(ber, words):
    with pytest.raises(MalformedError, match=words):
        to_der(bytes.fromhex(ber))


@pytest.mark.parametrize("der", ["0500", "0101ff", "020100", "02020080", "0202ff7f", "030100"])
def test_values_of_the_right_length_are_read(der):
    assert to_der(bytes.fromhex(der)) == bytes.fromhex(der)


def test_a_length_in_more_octets_than_it_takes_is_read():
    assert to_der(bytes.fromhex("308100")) == bytes.fromhex("3000")
    assert to_der(bytes.fromhex("0482000161")) == bytes.fromhex("040161")


def test_two_zeros_end_nothing_that_has_a_length():
    der = bytes.fromhex("3005 0000 020105")
    assert to_der(der) == der


def test_ber_that_nests_without_end_is_refused():
    assert to_der(b"\x30\x80" * MAX_DEPTH + b"\0\0" * MAX_DEPTH)
    for depth in (MAX_DEPTH + 2, 100_000):
        with pytest.raises(MalformedError, match="nests too deeply"):
            to_der(b"\x30\x80" * depth + b"\0\0" * depth)


def test_ber_that_is_very_large_is_refused_before_any_work():
    assert to_der(b"\4\x83\x0f\xff\xfb" + bytes(MAX_SIZE - 5))
    with pytest.raises(MalformedError, match=f"larger than {MAX_SIZE} bytes"):
        to_der(b"\4\x83\x0f\xff\xfc" + bytes(MAX_SIZE - 4))


def test_ber_with_very_many_parts_is_refused():
    with pytest.raises(MalformedError, match="too many parts"):
        to_der(b"\x30\x80" + b"\5\0" * (MAX_CHILDREN + 1) + b"\0\0")
    assert to_der(b"\x30\x80" + b"\5\0" * MAX_CHILDREN + b"\0\0").count(b"\5\0") == MAX_CHILDREN


# The MIME file


def test_a_document_that_is_not_signed_is_refused_with_the_way_out(lab):
    header = b"Content-Type: multipart/signed; boundary=x\n"
    for text in (DOCUMENT, b"\n\n", b"Content-Type: text/plain\n\nhello", header):
        with pytest.raises(VerificationError, match="not an S/MIME signed document") as caught:
            lab.verify(text)
        assert "pqsec sign" in caught.value.hint
    with pytest.raises(VerificationError, match="the file is empty"):
        lab.verify(b"")


def test_an_opaque_signature_is_refused(lab):
    opaque = (
        b"MIME-Version: 1.0\nContent-Type: application/x-pkcs7-mime; smime-type=signed-data;"
        b' name="smime.p7m"\nContent-Transfer-Encoding: base64\n\n'
    ) + base64.encodebytes(cms_of(lab.sign()))
    with pytest.raises(VerificationError, match="not an S/MIME signed document"):
        lab.verify(opaque)


@pytest.mark.parametrize("kind", [b"text/xml", b"application/xml", b"text/plainer", b""])
def test_a_signed_part_that_is_not_plain_text_is_refused(lab, kind):
    # Validly signed so, as without OpenSSL's -text option: no stack would read it.
    header = b"Content-Type: " + kind + b"\r\n\r\n"
    info = make(lab.main, header + crlf(DOCUMENT), now=NOW)
    message = with_data(lab.sign(), signer_infos=SetOf([info]))
    message = message.replace(b"\nContent-Type: text/plain\n", b"\nContent-Type: " + kind + b"\n")
    [problem] = lab.problems(message)
    assert "not text/plain, so no DDS stack would read it" in problem


def test_a_file_over_the_limit_is_refused(lab):
    with pytest.raises(VerificationError, match="larger than 8388608 bytes"):
        lab.verify(bytes(MAX_MESSAGE + 1))
    with pytest.raises(MalformedError):
        document_in(bytes(MAX_MESSAGE + 1))


def boundary_of(message):
    return re.search(rb'boundary="(.*?)"', message)[1]


MIME_FLAWS = {
    "no boundary": lambda m: m.replace(b'; boundary="' + boundary_of(m) + b'"', b""),
    "another boundary": lambda m: m.replace(boundary_of(m), b"other", 1),
    "cut in the text": lambda m: m[:600],
    "cut in the signature": lambda m: m[:-200],
    "no closing line": lambda m: m.replace(b"--" + boundary_of(m) + b"--\n", b""),
    "a third part": lambda m: m.replace(
        b"--" + boundary_of(m) + b"--",
        b"--" + boundary_of(m) + b"\n\nx\n--" + boundary_of(m) + b"--",
    ),
    "closed too early": lambda m: m.replace(
        b"--" + boundary_of(m) + b"\n", b"--" + boundary_of(m) + b"--\n", 1
    ),
    "no header on the signature": lambda m: re.sub(
        rb"(?s)\nContent-Type: application.*?\n\n", b"\n", m
    ),
    "a signature that is not base64": lambda m: m.replace(b'smime.p7s"\n\n', b'smime.p7s"\n\n!'),
    "no signature": lambda m: m.replace(
        base64.encodebytes(cms_of(m)).replace(b"\n", b"")[:64], b"", 1
    ),
    "a space before the text": lambda m: m.replace(b"text/plain\n\n", b"text/plain\n\n "),
    "a line less": lambda m: m.replace(b"text/plain\n\n", b"text/plain\n\n\n"),
    "a header more": lambda m: m.replace(b"text/plain\n", b"text/plain\nX-More: 1\n"),
    "a newline after the text": lambda m: m.replace(
        b"\n--" + boundary_of(m) + b"\nContent-Type: app",
        b"\n\n--" + boundary_of(m) + b"\nContent-Type: app",
    ),
}


@pytest.mark.parametrize("flaw", MIME_FLAWS)
def test_a_file_that_was_tampered_with_is_refused(lab, flaw):
    message = lab.sign()
    altered = MIME_FLAWS[flaw](message)
    assert altered != message
    with pytest.raises(VerificationError):
        lab.verify(altered)


def test_a_signature_part_without_a_header_is_told_as_that(lab):
    altered = MIME_FLAWS["no header on the signature"](lab.sign())
    with pytest.raises(VerificationError, match="signature part of the document has no header"):
        lab.verify(altered)


def test_a_signer_whose_name_cannot_be_read_is_not_listed(lab):
    issuer = raw(bytes.fromhex("300d310b300906035504060c02ff00"))  # UTF8String FF 00
    number = lab.main.certificate.serial_number
    sid = IssuerAndSerialNumber(issuer=issuer, serial_number=number)
    with pytest.raises(MalformedError, match="the signer's name cannot be read"):
        signers_in(with_info(lab.sign(), sid=sid))


@pytest.mark.parametrize("rest", [b"x", b"-", b"---", b" x", b"-- x", b"\rx", b" \rx"])
def test_a_line_that_begins_as_the_boundary_and_goes_on_is_read_by_nobody(lab, rest):
    # It ends no part (RFC 2046 5.1.1), but does so for OpenSSL.
    message = lab.sign()
    line = b"--" + boundary_of(message) + rest + b"\n"
    forged = message.replace(b"</dds>", line + b"</dds>", 1)
    with pytest.raises(AmbiguousError):
        document_in(forged)


@pytest.mark.timeout(120)  # what is quadratic takes hours
def test_boundary_lines_beyond_number_are_refused_at_once():
    head = b'Content-Type: multipart/signed; boundary="b"\n\n'
    for line in (b"--b\n", b"--bx\n"):
        with pytest.raises(MalformedError, match="two parts"):
            document_in(head + line * 1_000_000)


@pytest.mark.timeout(120)  # what is quadratic takes days
def test_carriage_returns_beyond_number_are_refused_at_once():
    """A peer's permissions are such a file: one could stop the agent, which serves all."""
    head = b'Content-Type: multipart/signed; boundary="b"\n\n--b\n'
    for message in (b"\r" * (8 << 20), head + b"\r" * (7 << 20), head + b"\rx" * (3 << 20)):
        with pytest.raises(MalformedError, match=r"multipart/signed|two parts"):
            document_in(message)


def test_headers_may_be_written_otherwise(lab):
    message = lab.sign()
    boundary = boundary_of(message)
    otherwise = message.replace(
        b'; protocol="application/x-pkcs7-signature"; micalg="sha-256"; boundary="'
        + boundary
        + b'"',
        b";\n\tBOUNDARY=" + boundary + b";\n micalg=sha-256",
    ).replace(b"MIME-Version", b"X-Sent-By: me\nmime-version")
    assert otherwise.count(b"\n") == message.count(b"\n") + 3
    lab.verify(otherwise)


def test_what_stands_around_the_parts_is_not_looked_at(lab):
    message = lab.sign()
    around = message.replace(b"This is an S/MIME signed message", b"<dds>evil</dds>") + b"trailer\n"
    assert lab.verify(around).document == crlf(DOCUMENT)


def test_an_unverified_document_can_be_looked_at(lab):
    forged = sign(DOCUMENT, lab.mallory, now=NOW)
    assert document_in(forged) == crlf(DOCUMENT)
    with pytest.raises(MalformedError):
        document_in(DOCUMENT)


def test_everything_that_is_wrong_is_said(lab):
    message = lab.countersigned().replace(b"ENCRYPT", b"encrypt", 1)
    forged = with_info(message, signature=b"\0" * 64)
    found = lab.problems(forged)
    assert found == (
        "the content was changed after signing",
        "bad ecdsa-p256 signature",
        "the countersignature: the content was changed after signing",
    )


def test_a_signer_prints_nothing_of_its_key(lab):
    assert "Key(" not in repr(lab.main)
    assert lab.main.key.raw.hex() not in repr(lab.main)


# What a handshake carries


def test_a_larger_cms_structure_than_is_carried_is_refused(lab):
    cms, document = parts_of(lab.sign())
    assert parts_of(joined(cms, document)) == (cms, document)
    with pytest.raises(MalformedError, match=f"larger than {MAX_CARRIED} bytes"):
        joined(bytes(MAX_CARRIED + 1), document)
    with pytest.raises(MalformedError, match=f"more than {MAX_CARRIED_VALUES} values"):
        joined(bytes(MAX_CARRIED), document)


def test_a_cms_structure_with_more_values_than_are_carried_is_refused(lab):
    """Each is counted, however deep, before any is converted."""
    limit_values(b"\x05\0" * 7, 7)
    limit_values(b"\x30\x04\x30\x02\x05\0" + b"\x04\x03abc", 4)
    for data, most in ((b"\x05\0" * 8, 7), (b"\x30\x04\x30\x02\x05\0" + b"\x04\x03abc", 3)):
        with pytest.raises(MalformedError, match=f"more than {most} values"):
            limit_values(data, most)


# What OpenSSL streams


@pytest.mark.interop
@pytest.mark.parametrize("name", ["ecdsa-p256", "rsa-2048"])
@pytest.mark.parametrize("options", [[], ["-nocerts"], ["-nosmimecap"], ["-md", "sha512"]])
def test_what_openssl_streams_as_ber_verifies(requires, tmp_path, name, options):
    openssl = requires(shutil.which("openssl"), "openssl", "apt-get install openssl")
    ca = Authority.create("CA", SIGNATURES.named(name), now=datetime.now(UTC), validity=YEAR)
    files = {"ca": ca.certificate.pem, "key": private_key_pem(ca.key), "doc": DOCUMENT}
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    command = [openssl, "cms", "-sign", "-stream", "-text", "-in", "doc", "-signer", "ca"]
    message = subprocess.run(
        [*command, "-inkey", "key", *options], cwd=tmp_path, capture_output=True, check=True
    ).stdout
    [found] = verify(message, ca.certificate).signatures
    assert found.algorithm.name == name
    with pytest.raises(VerificationError, match="changed after signing"):
        verify(message.replace(b"ENCRYPT", b"encrypt", 1), ca.certificate)
