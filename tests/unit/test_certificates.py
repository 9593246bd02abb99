"""Certificates: issued as every stack takes them, and each flaw that must be refused."""

from dataclasses import fields
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    BitString,
    DirectoryAttributes,
    Extension,
    Oid,
    Signed,
    TBSCertificate,
    Validity,
    algorithm,
    attribute,
    bits,
    decode,
    encode,
    raw,
    time_of,
)
from pqsec_pki.algorithms import PROFILES, SIGNATURES, pem
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    common_name,
    verify_authority,
    verify_chain,
)
from pqsec_pki.certificates._names import name_line, name_text
from pqsec_pki.certificates._sequence import (
    MAX_SEQUENCE_NUMBER,
    SEQUENCE_NUMBER,
    read_sequence_number,
)
from pqsec_pki.certificates.authority import LAST_YEAR, cut, key_identifier
from pqsec_pki.certificates.certificate import MAX_CERTIFICATE
from pqsec_pki.errors import MalformedError, PqsecError, UsageError, VerificationError
from tests.unit import chains
from tests.unit.chains import T61, UTF8
from tests.unit.version_1 import in_version_1

NOW = datetime(2026, 11, 21, 12, 30, 15, tzinfo=UTC)
DAY, YEAR = timedelta(days=1), timedelta(days=365)
ROWS = [row for row in SIGNATURES if "3072" not in row.name and "4096" not in row.name]
BITS = 0x03
ALTERNATIVES = ("2.5.29.72", "2.5.29.73", "2.5.29.74")

each_row = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
each_profile = pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)


def row(name):
    return SIGNATURES.named(name)


def authority_of(name="Identity CA", main="p256", alternative=None, **validity):
    second = row(alternative) if alternative else None
    times = {"now": NOW, "validity": 10 * YEAR} | validity
    return Authority.create(name, row(main), alternative=second, **times)


def issue(ca, name="/robot", main="p256", alternative=None, **validity):
    second = row(alternative).generate().public_key if alternative else None
    times = {"now": NOW, "validity": YEAR} | validity
    return ca.issue(name, row(main).generate().public_key, alternative=second, **times)


@pytest.fixture(scope="module")
def ca():
    """A classical authority."""
    return authority_of()


@pytest.fixture(scope="module")
def double_ca():
    """An authority with an alternative key."""
    return authority_of(alternative="ml-dsa-65")


def rebuilt(certificate, signer=None, *, drop=(), add=(), **changes):
    """`certificate` with other fields, signed again by `signer` or with its old signature."""
    tbs = decode(TBSCertificate, certificate.tbs, "certificate")
    for name, value in changes.items():
        setattr(tbs, name, value)
    kept = [each for each in tbs.extensions if each.extn_id.dotted_string not in drop]
    tbs.extensions = [*kept, *add]
    identifier = decode(AlgorithmIdentifier, certificate.identifier, "identifier")
    content = encode(tbs)
    signature = signer.sign(content) if signer else certificate.signature
    signed = Signed(tbs=raw(content), signature_algorithm=identifier, signature=bits(signature))
    return Certificate.from_der(encode(signed))


def extension(oid, value, *, critical=False):
    return Extension(extn_id=Oid(oid), critical=critical, extn_value=value)


def usage(**allowed):
    names = [
        *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment"),
        *("key_agreement", "key_cert_sign", "crl_sign", "encipher_only", "decipher_only"),
    ]
    value = x509.KeyUsage(**dict.fromkeys(names, False) | allowed)
    return extension("2.5.29.15", value.public_bytes(), critical=True)


def window(not_before, not_after):
    return raw(encode(Validity(not_before=time_of(not_before), not_after=time_of(not_after))))


def problems(leaf, ca, *, now=NOW, **required):
    with pytest.raises(VerificationError) as caught:
        verify_chain(leaf, ca, now=now, **required)
    return caught.value.lines


# What is issued


@each_row
def test_an_authority_of_every_kind_vouches_for_itself_and_its_participants(row):
    ca = Authority.create("CA", row, now=NOW, validity=YEAR)
    leaf = ca.issue("/a", ca.key.public_key, now=NOW, validity=YEAR)
    verify_authority(ca.certificate, now=NOW)
    verify_chain(leaf, ca.certificate, now=NOW)
    assert ca.certificate.public_key.algorithm is row
    assert leaf.identifier == row.identifier
    marked = decode(AlgorithmIdentifier, row.identifier, "identifier")
    assert leaf.signature_algorithm == marked.algorithm.dotted_string


@each_profile
def test_a_chain_of_every_profile_holds(profile):
    second = profile.alternative_key
    ca = Authority.create("CA", profile.identity_key, alternative=second, now=NOW, validity=YEAR)
    key = profile.participant_key.generate()
    alternative = second.generate().public_key if second else None
    leaf = ca.issue("/a", key.public_key, alternative=alternative, now=NOW, validity=YEAR)
    verify_chain(leaf, ca.certificate, now=NOW, require_alternative=second is not None)
    assert leaf.public_key.spki == key.public_key.spki
    assert (leaf.alternative_key is None) == (second is None)
    assert len(leaf.handshake_keys) == (1 if second is None else 2)


def test_an_authority_is_as_every_stack_takes_it(ca):
    certificate = x509.load_der_x509_certificate(ca.certificate.der)
    found = {each.oid.dotted_string: each for each in certificate.extensions}
    assert certificate.version is x509.Version.v3
    assert certificate.subject == certificate.issuer
    assert set(found) == {"2.5.29.19", "2.5.29.15", "2.5.29.14"}
    assert found["2.5.29.19"].critical
    assert found["2.5.29.19"].value == x509.BasicConstraints(ca=True, path_length=0)
    key_usage = found["2.5.29.15"].value
    assert key_usage.key_cert_sign
    assert key_usage.crl_sign
    assert key_usage.digital_signature  # Cyclone DDS 0.10 checks the S/MIME purpose


def test_a_participant_is_as_every_stack_takes_it(ca):
    leaf = issue(ca)
    certificate = x509.load_der_x509_certificate(leaf.der)
    found = {each.oid.dotted_string: each for each in certificate.extensions}
    assert set(found) == {"2.5.29.19", "2.5.29.15", "2.5.29.14", "2.5.29.35"}
    assert found["2.5.29.19"].value == x509.BasicConstraints(ca=False, path_length=None)
    assert found["2.5.29.15"].value.digital_signature
    assert not found["2.5.29.15"].value.key_cert_sign
    authority_key = found["2.5.29.35"].value.key_identifier
    assert authority_key == ca.certificate.subject_key_identifier
    assert leaf.subject_key_identifier == key_identifier(leaf.public_key)
    certificate.verify_directly_issued_by(x509.load_der_x509_certificate(ca.certificate.der))


def test_alternative_extensions_are_never_critical(double_ca):
    for certificate in (double_ca.certificate, issue(double_ca, alternative="ml-dsa-65")):
        found = {each.oid.dotted_string: each for each in certificate.extensions}
        assert set(ALTERNATIVES) <= set(found)
        assert not any(found[oid].critical for oid in ALTERNATIVES)


@pytest.mark.parametrize(
    ("oid", "value", "tag", "text"),
    [
        ("1.2.3.4", "ab", UTF8, "1.2.3.4=#0C026162"),
        ("1.2.3.4", b"\xe9", T61, "1.2.3.4=#1401E9"),  # which cryptography writes in UTF-8
        ("2.5.4.45", b"\0Z", BITS, "x500UniqueIdentifier=#0302005A"),
        ("2.5.4.45", "ab", UTF8, "x500UniqueIdentifier=ab"),
    ],
)
def test_a_value_that_openssl_does_not_know_is_told_in_octets(oid, value, tag, text):
    made = Certificate.from_der(chains.leaf(subject=chains.name((oid, value, tag))))
    assert made.subject_name == text


def test_a_name_that_was_not_read_is_told_like_one_that_was():
    made = x509.Name([x509.NameAttribute(Oid("1.2.3.4"), "ab")])
    assert (name_text(made), name_line(made)) == ("1.2.3.4=#0C026162", "/1.2.3.4=ab")


@pytest.mark.parametrize("number", [1, MAX_SEQUENCE_NUMBER])
def test_a_sequence_number_is_that_of_a_ledger_line(number):
    assert read_sequence_number(encode(number)) == number
    outside = number - 1 if number == 1 else number + 1
    with pytest.raises(MalformedError, match="not the number of a ledger line"):
        read_sequence_number(encode(outside))


def test_another_attribute_in_the_place_of_the_sequence_number_is_none():
    for oid, number in ((SEQUENCE_NUMBER.dotted_string, 7), ("1.2.3.4", None)):
        value = encode(DirectoryAttributes(attribute=attribute(oid, encode(7))))
        made = chains.leaf(chains.extension(value, oid="2.5.29.9"))
        assert Certificate.from_der(made).number == number


def test_a_certificate_says_who_it_is_for(ca):
    leaf = issue(ca, "/fleet/robot 1")
    assert leaf.subject_name == "CN=/fleet/robot 1"
    assert leaf.subject_text == "/CN=\\/fleet\\/robot 1"  # as OpenSSL's X509_NAME_oneline
    assert leaf.subject_der == common_name("/fleet/robot 1")
    assert (
        leaf.fingerprint
        == x509.load_der_x509_certificate(leaf.der).fingerprint(hashes.SHA256()).hex()
    )
    assert not leaf.is_self_issued
    assert ca.certificate.is_self_issued
    assert leaf.version == 3


def test_a_certificate_shares_its_issuers_name_with_the_authority_that_is_in_use(ca):
    only = authority_of("The only CA of this name")
    leaf = issue(only)
    assert leaf.issuer is only.certificate.subject
    for each in (leaf, issue(ca)):
        assert each.issuer == x509.load_der_x509_certificate(each.der).issuer


def test_serial_numbers_are_positive_and_never_the_same(ca):
    serials = {issue(ca).serial_number for _ in range(20)}
    assert len(serials) == 20
    assert min(serials) > 0
    assert max(serials) < 1 << 159


@pytest.mark.parametrize("name", ["/a", "a" * 64, "/fleet/robot_1", "Identity CA", "r2-d2.local"])
def test_a_plain_name_can_be_used(ca, name):
    assert issue(ca, name).subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == name


@pytest.mark.parametrize("name", ["", "a" * 65, "/" + "x" * 1000])
def test_a_common_name_is_1_to_64_characters(ca, name):
    with pytest.raises(UsageError, match=f"1 to 64 characters.* has {len(name)} "):
        issue(ca, name)


@pytest.mark.parametrize(
    "name", ["/café", "a,b", "a=b", "a+b", 'a"b', "a\\b", "a\nb", "a\0b", "a;b"]
)
def test_a_name_that_stacks_read_differently_is_refused(name):
    with pytest.raises(UsageError, match="characters that DDS stacks read differently"):
        common_name(name)


# Validity


@pytest.mark.parametrize("name", [" a", "a ", "a  b", " "])
def test_a_name_with_spaces_that_stacks_read_differently_is_refused(name):
    with pytest.raises(UsageError, match="spaces where DDS stacks read them differently"):
        common_name(name)


def test_certificates_start_a_day_early(ca):
    assert ca.certificate.not_before == NOW - DAY
    assert issue(ca, now=NOW + 2 * DAY).not_before == NOW + DAY


def test_a_participant_does_not_begin_before_its_authority(ca):
    # A clock that is behind the one that made the CA.
    leaf = issue(ca, now=NOW - DAY / 2)
    assert leaf.not_before == ca.certificate.not_before
    assert leaf.not_after == NOW - DAY / 2 + YEAR


def test_a_participant_that_would_outlive_its_authority_is_cut(ca):
    leaf = issue(ca, validity=20 * YEAR)
    assert leaf.not_after == ca.certificate.not_after == NOW + 10 * YEAR


def test_an_expired_authority_issues_nothing(ca):
    for now in (ca.certificate.not_after, ca.certificate.not_after + DAY):
        with pytest.raises(PqsecError, match="the identity CA expired on 2036-11-18") as caught:
            issue(ca, now=now)
        assert caught.value.exit_code == 3


def test_an_authority_whose_time_has_not_begun_issues_nothing(ca):
    begins = ca.certificate.not_before
    with pytest.raises(PqsecError, match="it is not yet valid"):
        cut(begins, ca.certificate, begins - DAY)
    assert cut(begins + DAY, ca.certificate, begins) == begins + DAY


def test_fractions_of_seconds_are_left_out():
    ca = authority_of(now=NOW.replace(microsecond=999_999))
    assert ca.certificate.not_after.microsecond == ca.certificate.not_before.microsecond == 0


def test_times_are_in_utc():
    east = datetime.fromisoformat("2026-11-21T17:30:15+05:00")
    assert authority_of(now=east).certificate.not_before == NOW - DAY


@pytest.mark.parametrize("years", [1, 22, 23, 24, 30, 234])
def test_years_on_both_sides_of_2050_are_read_back(years):
    end = NOW.replace(year=NOW.year + years)
    certificate = authority_of(validity=end - NOW).certificate
    assert certificate.not_after == end
    assert x509.load_der_x509_certificate(certificate.der).not_valid_after_utc == end


def test_a_year_that_stacks_cannot_represent_is_refused():
    last = datetime(LAST_YEAR, 12, 31, 23, 59, 59, tzinfo=UTC)
    assert authority_of(validity=last - NOW).certificate.not_after == last
    for validity in (last - NOW + timedelta(seconds=1), timedelta.max):
        with pytest.raises(UsageError, match="reaches beyond 2261"):
            authority_of(validity=validity)


@pytest.mark.parametrize("validity", [timedelta(), -DAY])
def test_a_validity_of_nothing_is_refused(ca, validity):
    for make in (authority_of, lambda **kw: issue(ca, **kw)):
        with pytest.raises(UsageError, match="must be positive"):
            make(validity=validity)


# A chain that must be refused


def test_a_participant_that_expired_is_refused(ca):
    leaf = issue(ca)
    verify_chain(leaf, ca.certificate, now=leaf.not_after)
    late = leaf.not_after + timedelta(seconds=1)
    assert problems(leaf, ca.certificate, now=late) == (
        "the certificate of CN=/robot expired on 2027-11-21 12:30:15 UTC",
    )


def test_a_participant_that_is_not_yet_valid_is_refused(ca):
    leaf = issue(ca, now=NOW + 10 * DAY)
    verify_chain(leaf, ca.certificate, now=leaf.not_before)
    early = leaf.not_before - timedelta(seconds=1)
    [problem] = problems(leaf, ca.certificate, now=early)
    assert "is not valid before 2026-11-30" in problem


def test_an_authority_that_expired_is_refused_with_its_participants():
    ca = authority_of(validity=DAY)
    leaf = rebuilt(issue(ca), ca.key, validity=window(NOW, NOW + YEAR))
    [problem] = problems(leaf, ca.certificate, now=NOW + 2 * DAY)
    assert problem.startswith("the CA certificate expired on")


def test_an_authority_that_is_not_yet_valid_is_refused(ca):
    with pytest.raises(VerificationError, match="the CA certificate is not valid before"):
        verify_authority(ca.certificate, now=NOW - 2 * DAY)


def test_another_authority_is_refused(ca):
    other = authority_of("Other CA")
    [problem] = problems(issue(ca), other.certificate)
    assert "was issued by CN=Identity CA, not by CN=Other CA" in problem


@each_row
def test_another_authority_of_the_same_name_is_refused(row):
    ca, other = (Authority.create("CA", row, now=NOW, validity=YEAR) for _ in range(2))
    leaf = ca.issue("/a", other.key.public_key, now=NOW, validity=YEAR)
    [problem] = problems(leaf, other.certificate)
    assert "same name, another key, or altered" in problem


def test_an_authority_of_the_same_name_and_another_algorithm_is_refused(ca):
    [problem] = problems(issue(ca), authority_of(main="ml-dsa-65").certificate)
    assert "same name, another key, or altered" in problem


def test_a_participant_is_no_authority(ca):
    key = row("p256").generate()
    fake = Authority(ca.issue("/mallory", key.public_key, now=NOW, validity=YEAR), key)
    found = problems(issue(fake, "/robot"), fake.certificate)
    assert any("not marked as a CA" in problem for problem in found)
    assert any("keyUsage lacks keyCertSign" in problem for problem in found)
    assert any("is not self-signed" in problem for problem in found)


def test_an_authority_without_basic_constraints_is_refused(ca):
    certificate = rebuilt(ca.certificate, ca.key, drop=["2.5.29.19"])
    assert problems(issue(ca), certificate) == (
        "the CA certificate is not marked as a CA (basicConstraints)",
    )


def test_an_authority_that_may_not_sign_certificates_is_refused(ca):
    certificate = rebuilt(
        ca.certificate, ca.key, drop=["2.5.29.15"], add=[usage(digital_signature=True)]
    )
    assert problems(issue(ca), certificate) == (
        "the CA certificate may not sign certificates (keyUsage lacks keyCertSign)",
    )


def test_an_authority_without_key_usage_may_sign(ca):
    # As `openssl req -x509` makes them.
    certificate = rebuilt(ca.certificate, ca.key, drop=["2.5.29.15", "2.5.29.14"])
    verify_chain(issue(ca), certificate, now=NOW)


def test_an_altered_authority_is_refused(ca):
    certificate = rebuilt(ca.certificate, serial_number=7)
    assert problems(issue(ca), certificate) == (
        "the signature of the CA certificate was not made with its own key",
    )


def test_a_certificate_signed_with_sha1_is_refused_for_that_reason(ca):
    # It was refused as "not its own", which is false: nobody looks at the signature.
    sha1 = algorithm("1.2.840.10045.4.1")

    def signed_with_sha1(certificate):
        tbs = decode(TBSCertificate, certificate.tbs, "certificate")
        tbs.signature = sha1
        signature = bits(certificate.signature)
        signed = Signed(tbs=raw(encode(tbs)), signature_algorithm=sha1, signature=signature)
        return Certificate.from_der(encode(signed))

    leaf = issue(ca)
    reason = "is made with SHA-1, which is no longer safe"
    assert problems(leaf, signed_with_sha1(ca.certificate)) == (
        f"the signature of the CA certificate {reason}",
    )
    assert problems(signed_with_sha1(leaf), ca.certificate) == (
        f"the signature of the certificate of {leaf.subject_name} {reason}",
    )


def test_an_intermediate_authority_is_refused(ca):
    key = row("p256").generate()
    extensions = [
        each
        for each in decode(TBSCertificate, ca.certificate.tbs, "tbs").extensions
        if each.extn_id.dotted_string in {"2.5.29.19", "2.5.29.15"}
    ]
    leaf = ca.issue("Intermediate", key.public_key, now=NOW, validity=YEAR)
    certificate = rebuilt(leaf, ca.key, drop=["2.5.29.19", "2.5.29.15"], add=extensions)
    found = problems(issue(Authority(certificate, key)), certificate)
    assert found == ("the CA certificate is not self-signed",)


def test_a_ca_as_a_participant_is_refused(ca):
    leaf = issue(ca)
    marked = x509.BasicConstraints(ca=True, path_length=None).public_bytes()
    another = extension("2.5.29.19", marked, critical=True)
    altered = rebuilt(leaf, ca.key, drop=["2.5.29.19"], add=[another])
    [problem] = problems(altered, ca.certificate)
    assert "is a CA's, not a participant's" in problem
    assert any("is a CA's" in each for each in problems(ca.certificate, ca.certificate))


def test_an_unknown_critical_extension_of_the_authority_is_refused(ca):
    other = rebuilt(ca.certificate, ca.key, add=[extension("1.2.3", b"\5\0", critical=True)])
    [problem] = problems(issue(ca), other)
    assert problem == "the CA certificate has an unknown critical extension 1.2.3"


def test_a_participant_that_may_not_sign_is_refused(ca):
    leaf = rebuilt(issue(ca), ca.key, drop=["2.5.29.15"], add=[usage(key_encipherment=True)])
    [problem] = problems(leaf, ca.certificate)
    assert "may not sign (keyUsage lacks digitalSignature)" in problem


def test_an_unknown_critical_extension_is_refused(ca):
    unknown = extension("1.3.6.1.4.1.99999.1", b"\x05\x00", critical=True)
    [problem] = problems(rebuilt(issue(ca), ca.key, add=[unknown]), ca.certificate)
    assert "unknown critical extension 1.3.6.1.4.1.99999.1" in problem


def test_an_unknown_extension_that_is_not_critical_is_passed_over(ca):
    unknown = extension("1.3.6.1.4.1.99999.1", b"\x05\x00")
    verify_chain(rebuilt(issue(ca), ca.key, add=[unknown]), ca.certificate, now=NOW)


@pytest.mark.parametrize("oid", ALTERNATIVES)
def test_a_critical_alternative_extension_is_refused(double_ca, oid):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    [old] = [
        each
        for each in decode(TBSCertificate, leaf.tbs, "tbs").extensions
        if each.extn_id.dotted_string == oid
    ]
    critical = extension(oid, old.extn_value, critical=True)
    found = problems(
        rebuilt(leaf, double_ca.key, drop=[oid], add=[critical]), double_ca.certificate
    )
    assert any(f"unknown critical extension {oid}" in problem for problem in found)


def test_extended_key_usage_is_understood(ca):
    value = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.EMAIL_PROTECTION]).public_bytes()
    leaf = rebuilt(issue(ca), ca.key, add=[extension("2.5.29.37", value, critical=True)])
    verify_chain(leaf, ca.certificate, now=NOW)


def test_a_version_1_participant_of_the_tutorials_is_taken(ca):
    leaf = in_version_1(issue(ca), ca.key)
    assert leaf.version == 1
    assert leaf.subject_key_identifier is None
    verify_chain(leaf, ca.certificate, now=NOW)


def test_a_version_1_ca_is_one_because_it_is_named_as_one(ca):
    old = in_version_1(ca.certificate, ca.key)
    verify_authority(old, now=NOW)
    verify_chain(issue(ca), old, now=NOW)


def test_everything_that_is_wrong_is_said(ca):
    other = authority_of("Other CA", validity=DAY)
    unknown = extension("1.2.3.4", b"\x05\x00", critical=True)
    leaf = rebuilt(issue(ca), ca.key, add=[unknown])
    found = problems(leaf, other.certificate, now=NOW + 2 * YEAR, require_alternative=True)
    assert len(found) == 7
    assert len(set(found)) == 7


# Alternative signatures


def test_an_alternative_signature_is_demanded_where_it_is_required(ca, double_ca):
    leaf = issue(ca)
    verify_chain(leaf, ca.certificate, now=NOW)
    assert problems(leaf, ca.certificate, require_alternative=True) == (
        "the CA certificate has no alternative key",
        "the certificate of CN=/robot has no alternative signature",
        "the certificate of CN=/robot has no alternative key",
    )
    verify_chain(
        issue(double_ca, alternative="ml-dsa-65"),
        double_ca.certificate,
        now=NOW,
        require_alternative=True,
    )


def test_a_participant_without_an_alternative_key_is_refused_where_it_is_required(double_ca):
    leaf = issue(double_ca)
    verify_chain(leaf, double_ca.certificate, now=NOW)
    assert problems(leaf, double_ca.certificate, require_alternative=True) == (
        "the certificate of CN=/robot has no alternative key",
    )


def test_a_participant_that_was_signed_again_without_the_alternative_signature_is_refused(
    double_ca,
):
    # An attacker who breaks ECDSA can make everything but the ML-DSA signature.
    leaf = issue(double_ca, alternative="ml-dsa-65")
    stripped = rebuilt(leaf, double_ca.key, drop=ALTERNATIVES[1:])
    assert problems(stripped, double_ca.certificate, require_alternative=True) == (
        "the certificate of CN=/robot has no alternative signature",
    )


def test_a_participant_that_was_altered_and_signed_again_by_ecdsa_alone_is_refused(double_ca):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    altered = rebuilt(leaf, double_ca.key, subject=raw(common_name("/admin")))
    [problem] = problems(altered, double_ca.certificate)
    assert (
        problem
        == "the alternative signature of the certificate of CN=/admin: bad ml-dsa-65 signature"
    )


@pytest.mark.parametrize("value", [b"", bytes(200), bytes(70_000)])
def test_an_added_extension_that_begins_nearly_as_the_alternative_signature_is_refused(
    double_ca, value
):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    oid = "1.3.6.3.85.29.74"  # its DER ends in that of altSignatureValue's
    altered = rebuilt(leaf, double_ca.key, add=[extension(oid, value)])
    [problem] = problems(altered, double_ca.certificate)
    assert "bad ml-dsa-65 signature" in problem


def test_an_exchanged_alternative_key_is_refused(double_ca):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    mallory = extension("2.5.29.72", row("ml-dsa-65").generate().public_key.spki)
    order = [mallory, *(each for each in _extensions(leaf) if _oid(each) in ALTERNATIVES[1:])]
    altered = rebuilt(leaf, double_ca.key, drop=ALTERNATIVES, add=order)
    [problem] = problems(altered, double_ca.certificate)
    assert "bad ml-dsa-65 signature" in problem


def test_an_alternative_key_that_cannot_be_read_is_refused(double_ca):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    order = [extension("2.5.29.72", b"\x30\x00"), *_extensions(leaf)[-2:]]
    altered = rebuilt(leaf, double_ca.key, drop=ALTERNATIVES, add=order)
    [problem] = problems(altered, double_ca.certificate)
    assert problem.startswith("an alternative key cannot be read: ")


def _extensions(certificate):
    return decode(TBSCertificate, certificate.tbs, "tbs").extensions


def _oid(each):
    return each.extn_id.dotted_string


def test_an_altered_alternative_signature_is_refused(double_ca):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    value = bytearray(leaf.alternative.signature)
    value[100] ^= 1
    bad = extension("2.5.29.74", encode(bits(bytes(value))))
    altered = rebuilt(leaf, double_ca.key, drop=["2.5.29.74"], add=[bad])
    [problem] = problems(altered, double_ca.certificate)
    assert "bad ml-dsa-65 signature" in problem


def test_an_alternative_signature_by_another_authority_is_refused(double_ca):
    other = authority_of(alternative="ml-dsa-65")
    mixed = Authority(double_ca.certificate, double_ca.key, other.alternative_key)
    [problem] = problems(issue(mixed, alternative="ml-dsa-65"), double_ca.certificate)
    assert "bad ml-dsa-65 signature" in problem


@pytest.mark.parametrize("check", ["verify_signature", "verify_alternative"])
def test_a_signer_whose_signature_was_refused_is_refused_again(double_ca, check):
    """Only a good signature is remembered."""
    leaf, other = issue(double_ca, alternative="ml-dsa-65"), authority_of(alternative="ml-dsa-65")
    keys = {"verify_signature": "public_key", "verify_alternative": "alternative_key"}
    for _ in range(2):
        with pytest.raises(VerificationError, match=r"bad .* signature"):
            getattr(leaf, check)(getattr(other.certificate, keys[check]))
        getattr(leaf, check)(getattr(double_ca.certificate, keys[check]))


def test_an_alternative_signature_marked_with_another_algorithm_is_refused(double_ca):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    marked = extension("2.5.29.73", row("ml-dsa-87").identifier)
    [value] = [each for each in _extensions(leaf) if _oid(each) == "2.5.29.74"]
    altered = rebuilt(leaf, double_ca.key, drop=ALTERNATIVES[1:], add=[marked, value])
    [problem] = problems(altered, double_ca.certificate)
    assert "marked with an algorithm that does not fit" in problem


def test_an_alternative_signature_that_nobody_can_check_is_passed_over(ca, double_ca):
    # The CA has no alternative key: nothing is known against the signature.
    mixed = Authority(ca.certificate, ca.key, double_ca.alternative_key)
    verify_chain(issue(mixed, alternative="ml-dsa-65"), ca.certificate, now=NOW)


@pytest.mark.parametrize("dropped", ALTERNATIVES[1:])
def test_half_an_alternative_signature_is_refused(double_ca, dropped):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    with pytest.raises(MalformedError, match="half an alternative signature"):
        rebuilt(leaf, double_ca.key, drop=[dropped])


def test_an_alternative_signature_with_unused_bits_is_refused(double_ca):
    leaf = issue(double_ca, alternative="ml-dsa-65")
    bad = extension("2.5.29.74", encode(BitString(b"\x80", 7)))
    with pytest.raises(MalformedError, match="not a whole number of bytes"):
        rebuilt(leaf, double_ca.key, drop=["2.5.29.74"], add=[bad])


@pytest.mark.parametrize("where", ["participant", "authority"])
def test_a_broken_alternative_key_is_refused(double_ca, where):
    broken = extension("2.5.29.72", b"\x30\x00")
    whole = {"participant": issue(double_ca, alternative="ml-dsa-65"), "authority": None}
    target = whole[where] or double_ca.certificate
    bad = rebuilt(target, double_ca.key, drop=["2.5.29.72"], add=[broken])
    with pytest.raises(MalformedError):
        _ = bad.alternative_key
    leaf = bad if where == "participant" else issue(double_ca, alternative="ml-dsa-65")
    authority = bad if where == "authority" else double_ca.certificate
    with pytest.raises(PqsecError):
        verify_chain(leaf, authority, now=NOW, require_alternative=True)


# Reading


def test_a_certificate_is_read_back_from_pem_and_der(double_ca):
    certificate = issue(double_ca, alternative="ml-dsa-65")
    for copy in (
        Certificate.from_pem(certificate.pem),
        Certificate.from_pem(b"text\n" + pem("OTHER", b"1") + certificate.pem + b"more"),
        Certificate.from_der(certificate.der),
    ):
        names = [field.name for field in fields(Certificate) if field.name != "extensions"]
        same = [name for name in names if getattr(copy, name) == getattr(certificate, name)]
        assert same == names


@pytest.mark.parametrize("data", [b"", b"text", pem("CERTIFICATE", b""), pem("X509 CRL", b"123")])
def test_what_is_no_certificate_is_refused(data):
    with pytest.raises(MalformedError):
        Certificate.from_pem(data)


def test_bytes_after_a_certificate_are_refused(ca):
    with pytest.raises(MalformedError):
        Certificate.from_der(ca.certificate.der + b"\0")


def test_a_certificate_over_the_limit_is_refused(ca):
    with pytest.raises(MalformedError, match="larger than"):
        Certificate.from_der(bytes(MAX_CERTIFICATE + 1))
    with pytest.raises(MalformedError, match="larger than"):
        Certificate.from_pem(ca.certificate.pem + bytes(MAX_CERTIFICATE))
    with pytest.raises(MalformedError) as caught:
        Certificate.from_der(bytes(MAX_CERTIFICATE))
    assert "larger than" not in str(caught.value)


def test_a_certificate_that_names_two_algorithms_is_refused(ca):
    signed = decode(Signed, ca.certificate.der, "certificate")
    signed.signature_algorithm = algorithm("2.16.840.1.101.3.4.3.18")
    with pytest.raises(MalformedError, match="two different signature algorithms"):
        Certificate.from_der(encode(signed))


@pytest.mark.parametrize("version", [1, 3, 7, -1])
def test_a_version_that_does_not_exist_is_refused(ca, version):
    with pytest.raises(MalformedError):
        rebuilt(ca.certificate, ca.key, version=version)


@pytest.mark.parametrize("serial", [0, -1, -(2**64)])
def test_a_serial_number_that_is_not_positive_is_read_as_all_stacks_read_it(ca, serial):
    assert rebuilt(ca.certificate, ca.key, serial_number=serial).serial_number == serial


def test_a_repeated_extension_is_refused(ca):
    twice = [each for each in _extensions(ca.certificate) if _oid(each) == "2.5.29.15"]
    with pytest.raises(MalformedError, match="Duplicate"):
        rebuilt(ca.certificate, ca.key, add=twice)


def test_a_broken_extension_is_refused_at_the_door(ca):
    with pytest.raises(MalformedError):
        rebuilt(ca.certificate, ca.key, add=[extension("2.5.29.17", b"\x30\x03\x82\x01")])


@pytest.mark.parametrize(
    "time",
    [
        pytest.param(b"\x05\x00", id="NULL"),
        pytest.param(b"\x17\x0d000000000000Z", id="month 0"),
        pytest.param(b"\x17\x0b2601010000Z", id="no seconds"),
        pytest.param(b"\x18\x0f00000101000000Z", id="year 0"),
        pytest.param(b"\x18\x1320260101000000+0100", id="an offset"),
    ],
)
def test_a_time_that_is_none_is_refused(ca, time):
    good = encode(time_of(NOW))
    content = good + time
    with pytest.raises(MalformedError):
        rebuilt(ca.certificate, ca.key, validity=raw(bytes([0x30, len(content)]) + content))


def test_a_signature_with_unused_bits_is_refused(ca):
    signed = decode(Signed, ca.certificate.der, "certificate")
    signed.signature = BitString(b"\x80", 7)
    with pytest.raises(MalformedError, match="not a whole number of bytes"):
        Certificate.from_der(encode(signed))


def test_an_authority_prints_none_of_its_keys(double_ca):
    shown = repr(double_ca)
    assert "Key(" not in shown
    assert double_ca.key.raw.hex() not in shown
    assert double_ca.alternative_key.raw.hex() not in shown
