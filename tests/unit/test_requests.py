"""Certification requests and revocation lists: what is read, and what proofs hold."""

import shutil
import subprocess
from datetime import UTC, datetime, timedelta
from functools import cache, partial

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    CertificationRequestInfo,
    Extension,
    Oid,
    PreTBSCertList,
    Signed,
    TBSCertList,
    attribute,
    bits,
    decode,
    encode,
    raw,
)
from pqsec_pki.algorithms import SIGNATURES, pem
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    CertificateRequest,
    RevocationList,
    common_name,
)
from pqsec_pki.errors import MalformedError, VerificationError
from tests.some_keys import some_key as key

NOW = datetime(2026, 6, 1, tzinfo=UTC)
YEAR = timedelta(days=365)
ALT_KEY, ALT_ALGORITHM, ALT_VALUE = "2.5.29.72", "2.5.29.73", "2.5.29.74"

other_key = partial(key, owner="bob")


@cache
def authority(alternative=None):
    return Authority.create(
        "CA",
        SIGNATURES.named("p256"),
        alternative=SIGNATURES.named(alternative) if alternative else None,
        now=NOW,
        validity=YEAR,
    )


def identifier(private):
    return decode(AlgorithmIdentifier, private.algorithm.identifier, "")


def signed(content, private):
    signature = bits(private.sign(content))
    return encode(
        Signed(tbs=raw(content), signature_algorithm=identifier(private), signature=signature)
    )


def request_info(private, attributes):
    return encode(
        CertificationRequestInfo(
            version=0,
            subject=raw(common_name("/talker")),
            subject_public_key_info=raw(private.public_key.spki),
            attributes=sorted(attributes, key=encode),
        )
    )


def request(private, alternative=None, signer=None):
    """A request made as BouncyCastle does; `signer` makes the alternative proof instead."""
    if alternative is None:
        return signed(request_info(private, []), private)
    signer = signer or alternative
    attributes = [
        attribute(ALT_KEY, alternative.public_key.spki),
        attribute(ALT_ALGORITHM, signer.algorithm.identifier),
    ]
    proof = signer.sign(request_info(private, attributes))
    attributes.append(attribute(ALT_VALUE, encode(bits(proof))))
    return signed(request_info(private, attributes), private)


def crl(ca, *, number=7, critical=False):
    """A classical revocation list of `ca`, which takes back certificates 1 and 2."""
    one = x509.RevokedCertificateBuilder().serial_number(1).revocation_date(NOW)
    two = x509.RevokedCertificateBuilder().serial_number(2).revocation_date(NOW)
    two = two.add_extension(x509.CRLReason(x509.ReasonFlags.key_compromise), critical=False)
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(ca.certificate.subject)
        .last_update(NOW)
        .next_update(NOW + timedelta(days=7))
        .add_extension(x509.CRLNumber(number), critical=False)
        .add_revoked_certificate(one.build())
        .add_revoked_certificate(two.build())
    )
    if critical:
        builder = builder.add_extension(x509.DeltaCRLIndicator(1), critical=True)
    made = builder.sign(ca.key.handle, hashes.SHA256())
    return made.public_bytes(Encoding.DER)


def with_alternative(der, ca, signer=None):
    """That list, signed by the alternative key too (X.509 9.8)."""
    tbs = decode(TBSCertList, encode(decode(Signed, der, "").tbs), "")
    signer = signer or ca.alternative_key

    def add(oid, value):
        extension = Extension(extn_id=Oid(oid), critical=False, extn_value=value)
        tbs.crl_extensions = [*tbs.crl_extensions, extension]

    add(ALT_ALGORITHM, signer.algorithm.identifier)
    names = ("version", "issuer", "this_update", "next_update", "revoked_certificates")
    kept = {name: getattr(tbs, name) for name in (*names, "crl_extensions")}
    add(ALT_VALUE, encode(bits(signer.sign(encode(PreTBSCertList(**kept))))))
    return signed(encode(tbs), ca.key)


def in_pem(der):
    return pem("CERTIFICATE REQUEST", der)


def test_all_requests_of_a_file_are_read_in_their_order_whatever_else_is_in_it():
    one, other = request(key("p256")), request(other_key("p256"))
    text = b"Comment\n" + in_pem(one) + authority().certificate.pem + in_pem(other)
    assert [each.der for each in CertificateRequest.all_from_pem(text)] == [one, other]


def test_a_file_is_refused_if_a_request_in_it_is_broken_or_there_are_none_or_too_many():
    one, broken = in_pem(request(key("p256"))), in_pem(b"\x30\x00")
    for data in (
        b"",
        authority().certificate.pem,
        one + broken,
        one + one[:-20],
        one + b"\0" + one,
    ):
        with pytest.raises(MalformedError):
            CertificateRequest.all_from_pem(data)
    with pytest.raises(MalformedError, match="more than 2000 certificate requests"):
        CertificateRequest.all_from_pem(broken * 2001)


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([("CN", "/talker")], "/talker"),
        ([], None),
        ([("O", "/talker")], None),
        ([("O", "Robots"), ("CN", "/talker")], None),
        ([("CN", "/talker"), ("CN", "/listener")], None),
    ],
)
def test_a_request_is_named_by_a_common_name_alone(parts, expected):
    oids = {"CN": x509.NameOID.COMMON_NAME, "O": x509.NameOID.ORGANIZATION_NAME}
    subject = x509.Name([x509.NameAttribute(oids[part], value) for part, value in parts])
    builder = x509.CertificateSigningRequestBuilder().subject_name(subject)
    made = builder.sign(key("p256").handle, hashes.SHA256())
    assert CertificateRequest.from_der(made.public_bytes(Encoding.DER)).common_name == expected


def test_an_attribute_that_says_nothing_of_keys_may_have_two_values():
    challenge = attribute("1.2.840.113549.1.9.2", b"\x0c\x011", b"\x0c\x012")
    made = CertificateRequest.from_der(signed(request_info(key("p256"), [challenge]), key("p256")))
    made.verify()
    assert made.alternative_key is None


@pytest.mark.parametrize("name", [row.name for row in SIGNATURES])
def test_a_request_of_any_key_proves_possession(name):
    made = CertificateRequest.from_der(request(key(name)))
    made.verify()
    assert made.subject_name == "CN=/talker"
    assert made.public_key.spki == key(name).public_key.spki
    assert made.alternative_key is None
    assert CertificateRequest.from_pem(made.pem).der == made.der


def test_a_request_with_an_alternative_key_proves_possession_of_both():
    made = CertificateRequest.from_der(request(key("p256"), key("ml-dsa-65")))
    made.verify()
    assert made.alternative_key.algorithm.name == "ml-dsa-65"


def test_a_request_signed_with_another_key_proves_nothing():
    der = signed(request_info(key("p256"), []), other_key("p256"))
    with pytest.raises(VerificationError, match="no proof that the requester has the private key"):
        CertificateRequest.from_der(der).verify()


def test_a_request_with_an_alternative_key_of_somebody_else_is_refused():
    der = request(key("p256"), key("ml-dsa-65"), signer=other_key("ml-dsa-65"))
    with pytest.raises(VerificationError, match="has the alternative private key: bad ml-dsa-65"):
        CertificateRequest.from_der(der).verify()


def test_an_alternative_key_without_its_proof_is_refused():
    info = request_info(key("p256"), [attribute(ALT_KEY, key("ml-dsa-65").public_key.spki)])
    with pytest.raises(VerificationError, match="has the alternative private key: there is no"):
        CertificateRequest.from_der(signed(info, key("p256"))).verify()


def test_an_alternative_proof_without_its_key_is_refused():
    private, signer = key("p256"), key("ml-dsa-65")
    attributes = [attribute(ALT_ALGORITHM, signer.algorithm.identifier)]
    proof = signer.sign(request_info(private, attributes))
    attributes.append(attribute(ALT_VALUE, encode(bits(proof))))
    with pytest.raises(VerificationError, match="a signature and no alternative key"):
        CertificateRequest.from_der(signed(request_info(private, attributes), private)).verify()


def test_half_an_alternative_signature_in_a_request_is_malformed():
    attributes = [attribute(ALT_ALGORITHM, key("ml-dsa-65").algorithm.identifier)]
    with pytest.raises(MalformedError, match="half an alternative signature"):
        CertificateRequest.from_der(signed(request_info(key("p256"), attributes), key("p256")))


def test_two_alternative_keys_in_a_request_are_malformed():
    keys = [attribute(ALT_KEY, made("ml-dsa-65").public_key.spki) for made in (key, other_key)]
    with pytest.raises(MalformedError, match="is missing or repeated"):
        CertificateRequest.from_der(signed(request_info(key("p256"), keys), key("p256")))


def test_an_attribute_with_two_alternative_keys_is_malformed():
    keys = attribute(ALT_KEY, *(made("ml-dsa-65").public_key.spki for made in (key, other_key)))
    with pytest.raises(MalformedError, match="is missing or repeated"):
        CertificateRequest.from_der(signed(request_info(key("p256"), [keys]), key("p256")))


def test_a_request_of_an_unknown_version_is_malformed():
    info = decode(CertificationRequestInfo, request_info(key("p256"), []), "")
    info.version = 5
    with pytest.raises(MalformedError, match="version"):
        CertificateRequest.from_der(signed(encode(info), key("p256")))


def test_a_revocation_list_that_names_two_algorithms_is_malformed():
    whole = decode(Signed, crl(authority()), "")
    whole.signature_algorithm = identifier(key("ml-dsa-44"))
    with pytest.raises(MalformedError, match="two different signature algorithms"):
        RevocationList.from_der(encode(whole))


def test_a_revocation_list_says_what_was_taken_back_when_and_why():
    made = RevocationList.from_der(crl(authority()))
    made.verify(authority().certificate)
    assert made.number == 7
    assert made.next_update - made.this_update == timedelta(days=7)
    first, second = made.revoked
    assert (first.serial_number, first.revoked_at, first.reason) == (1, NOW, None)
    assert (second.serial_number, second.reason) == (2, "keyCompromise")
    assert made.revocation_of(authority().certificate) is None
    assert RevocationList.from_pem(made.pem).der == made.der


def test_a_revocation_list_of_a_classical_authority_does_not_do_where_two_signatures_must_be():
    ca = authority()
    with pytest.raises(VerificationError) as caught:
        RevocationList.from_der(crl(ca)).verify(ca.certificate, require_alternative=True)
    assert caught.value.lines == (
        "the CA certificate has no alternative key",
        "the revocation list has no alternative signature",
    )


def test_a_revocation_list_with_both_signatures_holds():
    ca = authority("ml-dsa-65")
    made = RevocationList.from_der(with_alternative(crl(ca), ca))
    made.verify(ca.certificate, require_alternative=True)


def test_a_revocation_list_of_another_authority_is_refused():
    ours, other = authority(), Authority.create("Other", ours_row(), now=NOW, validity=YEAR)
    with pytest.raises(VerificationError, match="issued by CN=Other, not by CN=CA"):
        RevocationList.from_der(crl(other)).verify(ours.certificate)


def test_a_revocation_list_of_the_same_name_and_another_key_is_refused():
    impostor = Authority.create("CA", ours_row(), now=NOW, validity=YEAR)
    with pytest.raises(VerificationError, match="not signed by this CA"):
        RevocationList.from_der(crl(impostor)).verify(authority().certificate)


def ours_row():
    return SIGNATURES.named("p256")


def test_a_stripped_alternative_signature_is_missed_only_where_it_is_required():
    ca = authority("ml-dsa-65")
    made = RevocationList.from_der(crl(ca))
    made.verify(ca.certificate)
    with pytest.raises(VerificationError, match="has no alternative signature"):
        made.verify(ca.certificate, require_alternative=True)


def test_an_alternative_signature_by_another_key_is_refused():
    ca = authority("ml-dsa-65")
    der = with_alternative(crl(ca), ca, signer=other_key("ml-dsa-65"))
    with pytest.raises(VerificationError, match=r"alternative signature .* bad ml-dsa-65"):
        RevocationList.from_der(der).verify(ca.certificate)


def test_a_delta_list_is_refused():
    with pytest.raises(VerificationError, match=r"unknown critical extension 2\.5\.29\.27"):
        RevocationList.from_der(crl(authority(), critical=True)).verify(authority().certificate)


def test_a_participant_may_not_sign_revocation_lists():
    private = key("p256")
    leaf = authority().issue("CA", private.public_key, now=NOW, validity=YEAR)
    impostor = Authority(leaf, private)
    with pytest.raises(VerificationError, match="may not sign revocation lists"):
        RevocationList.from_der(crl(impostor)).verify(leaf)


@pytest.fixture
def openssl(requires, tmp_path):
    program = requires(shutil.which("openssl"), "OpenSSL", "apt install openssl")

    def run(*words):
        done = subprocess.run([program, *words], cwd=tmp_path, capture_output=True, check=True)
        return done.stdout

    return run


@pytest.mark.interop
@pytest.mark.parametrize("kind", ["rsa:2048", "ec"])
def test_a_request_made_by_openssl_is_read_and_proves_possession(openssl, kind):
    curve = ("-pkeyopt", "ec_paramgen_curve:P-256") if kind == "ec" else ()
    subject = ("-subj", "/O=Lab/CN=talker", "-addext", "subjectAltName=DNS:talker")
    pem = openssl("req", "-new", "-newkey", kind, *curve, "-nodes", "-keyout", "key", *subject)
    made = CertificateRequest.from_pem(pem)
    made.verify()
    assert made.subject_name == "CN=talker,O=Lab"
    assert made.extensions.get_extension_for_class(x509.SubjectAlternativeName)


@pytest.mark.interop
def test_openssl_takes_a_request_with_an_alternative_key(openssl, tmp_path):
    made = CertificateRequest.from_der(request(key("p256"), key("ml-dsa-65")))
    (tmp_path / "request.pem").write_bytes(made.pem)
    openssl("req", "-verify", "-noout", "-in", "request.pem")


@pytest.mark.interop
def test_a_revocation_list_made_by_openssl_is_read_and_holds(openssl, tmp_path):
    subject = ("-subj", "/CN=Lab CA", "-days", "9")
    openssl(
        "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "key", "-out", "ca", *subject
    )
    revoked = "R\t271231235959Z\t260501120000Z,superseded\t0A0B\tunknown\t/CN=talker\n"
    (tmp_path / "index").write_text(revoked)
    (tmp_path / "number").write_text("2A\n")
    (tmp_path / "conf").write_text(
        "[ca]\ndefault_ca=c\n[c]\ndatabase=index\ncrlnumber=number\ndefault_md=sha256\n"
        "default_crl_days=3\ncertificate=ca\nprivate_key=key\ncrl_extensions=e\n"
        "[e]\nauthorityKeyIdentifier=keyid\n"
    )
    made = RevocationList.from_pem(openssl("ca", "-gencrl", "-config", "conf"))
    made.verify(Certificate.from_pem((tmp_path / "ca").read_bytes()))
    assert made.number == 0x2A
    [only] = made.revoked
    assert (only.serial_number, only.reason) == (0x0A0B, "superseded")
