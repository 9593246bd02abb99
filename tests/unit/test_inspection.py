"""What is told of a file: the right words, by its content, and nothing private."""

import json
import re
import shutil
import subprocess
from datetime import UTC, datetime, timedelta
from functools import cache

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
)

from pqsec_pki._asn1 import OneAsymmetricKey, SeedAndExpandedKey, algorithm, decode, encode
from pqsec_pki.algorithms import SIGNATURES, pem, private_key_pem
from pqsec_pki.certificates import Authority
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
)
from pqsec_pki.errors import InvalidDocumentError, MalformedError
from pqsec_pki.inspection import Description, Fact, describe
from pqsec_pki.smime import Signer, sign
from pqsec_pki.tokens import reference_to
from tests.some_keys import some_key as key
from tests.unit.test_requests import crl, request, with_alternative

NOW = datetime(2026, 6, 1, tzinfo=UTC)
YEAR = timedelta(days=365)


@cache
def authority(name="ecdsa-p256", alternative=None):
    second = SIGNATURES.named(alternative) if alternative else None
    row = SIGNATURES.named(name)
    return Authority.create("Lab CA", row, alternative=second, now=NOW, validity=YEAR)


def participant(name="ecdsa-p256", alternative=None, by=None):
    second = key(alternative).public_key if alternative else None
    issuer = by or authority(alternative=alternative)
    return issuer.issue("/talker", key(name).public_key, alternative=second, now=NOW, validity=YEAR)


def told(data, *, now=NOW):
    description = describe(data, now=now)
    json.dumps(description.to_json())
    return "\n".join(description.to_text())


def fields(data):
    return describe(data, now=NOW).to_json()


def permissions():
    criteria = Criteria(
        topics=("rt/chatter",), partitions=("", "lab"), data_tags=(("room", "east"),)
    )
    forbidden = Criteria(topics=("rt/secret*",))
    grant = Grant(
        name="g",
        subject_name="CN=/talker",
        not_before=NOW,
        not_after=NOW + timedelta(days=3),
        rules=(
            PermissionRule(allow=False, domains=DomainSet.of(0), publish=(forbidden,)),
            PermissionRule(
                allow=True, domains=DomainSet.of(DomainRange(first=0, last=5)), publish=(criteria,)
            ),
        ),
        default=DefaultAction.DENY,
    )
    return Permissions(grants=(grant,)).to_xml()


def governance():
    return Governance.protected(DomainSet.of(0, 7)).to_xml()


@pytest.mark.parametrize("row", list(SIGNATURES), ids=lambda row: row.name)
def test_a_certificate_of_any_key_is_told_with_its_family_level_and_stacks(row):
    ca = authority(row.name)
    text, values = told(participant(row.name, by=ca).pem), fields(participant(row.name, by=ca).der)
    assert text.startswith("Participant certificate: CN=/talker")
    assert f"{row.name} (" in text
    assert values["kind"] == "certificate"
    assert values["key"]["family"] == row.family
    assert values["key"]["nist_level"] == row.level
    assert values["runs_in"] == row.runs_in


def test_a_ca_certificate_is_told_from_a_participants():
    assert "may sign certificates" in told(authority().certificate.pem)
    assert "issuer                   itself" in told(authority().certificate.pem)
    assert fields(authority().certificate.pem)["role"] == "ca"
    assert fields(participant().pem)["role"] == "participant"


def test_an_alternative_key_and_signature_are_told():
    text = told(participant(alternative="ml-dsa-65").pem)
    assert "alternative key        ml-dsa-65 (post-quantum, NIST level 3)" in text
    assert "alternative signature  ml-dsa-65 (not verified)" in text
    assert "all stock stacks; all but pqsec ignore" in text
    assert "alternative key        none" in told(participant().pem)


def test_a_stack_that_cannot_check_the_ca_cannot_take_the_identity():
    values = fields(participant("ecdsa-p256", by=authority("ml-dsa-65")).pem)
    assert values["runs_in"] == "no stock stack today"


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (NOW, "365 days left"),
        (NOW + timedelta(days=364), "1 day left"),
        (NOW + timedelta(days=364, hours=22, minutes=1), "1 hour left"),
        (NOW + timedelta(days=365, seconds=3), "expired less than a minute ago"),
        (NOW + timedelta(days=368), "expired 3 days ago"),
        (NOW - timedelta(days=3), "not valid yet: starts in 2 days"),
    ],
)
def test_how_long_a_certificate_is_valid_is_told(now, words):
    assert f"({words})" in told(participant().pem, now=now)


@pytest.mark.parametrize("row", list(SIGNATURES), ids=lambda row: row.name)
@pytest.mark.parametrize("write", [private_key_pem, lambda k: k.pkcs8], ids=["pem", "der"])
def test_a_private_key_and_its_certificate_are_told_to_belong_together(row, write):
    values = fields(write(key(row.name)))
    assert (values["kind"], values["encrypted"]) == ("private key", False)
    certificate = fields(participant(row.name, by=authority()).pem)
    assert values["public_key_sha256"] == certificate["public_key_sha256"]
    assert values["key"] == certificate["key"]


def test_a_pin_in_a_reference_is_not_shown():
    """Other tools write it there; pqsec refuses such a URI, but shows whose key it is."""
    found = told(reference_to("pkcs11:token=lab;object=k?pin-value=1234&x=1"))
    assert "token=lab;object=k" in found
    assert "1234" not in found


def test_the_form_of_a_post_quantum_key_is_told():
    private = key("ml-dsa-44")
    seed = decode(OneAsymmetricKey, private.pkcs8, "").private_key[2:]
    both = encode(SeedAndExpandedKey(seed=seed, expanded_key=private.public_key.raw[:32]))
    forms = {b"\x80\x20" + seed: "seed", both: "seed and expanded key", seed: "bare seed"}
    for octets, words in forms.items():
        assert f"PKCS#8, {words}" in told(key_info(private.algorithm.key_oid, octets))


def key_info(oid, octets):
    return encode(
        OneAsymmetricKey(
            version=0,
            algorithm=algorithm(oid),
            private_key=octets,
            attributes=None,
            public_key=None,
        )
    )


def test_an_expanded_key_alone_is_told_with_the_way_out():
    text = told(key_info(SIGNATURES.named("ml-dsa-65").key_oid, b"\x04\x82\x0f\xc0" + bytes(4032)))
    assert "ml-dsa-65, unusable here" in text
    assert "expanded key without its seed" in text
    assert "seed-only" in text


@pytest.mark.usefixtures("all_iterations")
def test_an_encrypted_key_is_told_without_its_passphrase():
    text = told(private_key_pem(key("ml-dsa-65"), b"pass"))
    assert text.startswith("Private key, encrypted")
    assert "PBKDF2 with 600000 iterations, AES-256-CBC" in text
    handle, encryption = key("p256").handle, BestAvailableEncryption(b"pass")
    der = handle.private_bytes(Encoding.DER, PrivateFormat.PKCS8, encryption)
    assert "2048 iterations, which is too few" in told(der)


@pytest.mark.parametrize(("name", "form"), [("p256", "SEC 1"), ("rsa-2048", "PKCS#1")])
def test_traditional_forms_are_told(name, form):
    def write(encoding, encryption):
        return key(name).handle.private_bytes(
            encoding, PrivateFormat.TraditionalOpenSSL, encryption
        )

    assert f"{form}, the traditional form" in told(write(Encoding.PEM, NoEncryption()))
    assert f"{form}, the traditional form" in told(write(Encoding.DER, NoEncryption()))
    assert "re-encrypt" in told(write(Encoding.PEM, BestAvailableEncryption(b"pass")))


def foreign_certificate(*extensions):
    """A self-signed certificate of an Ed25519 key, with these (extension, critical)."""
    private = ed25519.Ed25519PrivateKey.generate()
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "other")])
    builder = (
        x509.CertificateBuilder(name, name, private.public_key(), 5)
        .not_valid_before(NOW)
        .not_valid_after(NOW + YEAR)
    )
    for extension, critical in extensions:
        builder = builder.add_extension(extension, critical=critical)
    return builder.sign(private, None).public_bytes(Encoding.PEM)


def test_a_certificate_of_a_foreign_key_is_told_with_its_extensions():
    names = x509.SubjectAlternativeName(
        [x509.DNSName("robot"), x509.RegisteredID(x509.ObjectIdentifier("1.2.3"))]
    )
    unknown = x509.UnrecognizedExtension(x509.ObjectIdentifier("1.2.3.4"), b"\x05\x00")
    text = told(foreign_certificate((names, False), (unknown, True)))
    assert text.startswith("Self-signed certificate: CN=other")
    assert "not marked as a CA" in text
    assert "Ed25519, unusable here" in text
    assert re.search(r"\n  stacks +none\n", text)
    assert "other names: robot, 1.2.3" in text
    assert "1.2.3.4 (not known here, and critical)" in text


def test_a_ca_that_may_not_sign_certificates_is_told():
    nothing = dict.fromkeys(
        ("content_commitment", "key_encipherment", "data_encipherment", "key_agreement"), False
    ) | dict.fromkeys(("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"), False)
    usage = x509.KeyUsage(digital_signature=False, **nothing)
    marked = x509.BasicConstraints(ca=True, path_length=2)
    text = told(foreign_certificate((usage, True), (marked, True)))
    assert text.startswith("CA certificate that cannot issue")
    assert "may do nothing" in text
    assert "a CA, with at most 2 CAs below it" in text


def test_a_request_is_told_with_whether_its_proof_holds():
    text = told(request(key("p256"), key("ml-dsa-65")))
    assert "verified: the requester has the private key and the alternative key" in text
    stolen = request(key("p256"), key("ml-dsa-65"), signer=key("ml-dsa-44"))
    assert "no proof that the requester has the alternative private key" in told(stolen)
    assert fields(stolen)["proof"]["holds"] is False


def test_a_revocation_list_is_told():
    ca = authority(alternative="ml-dsa-65")
    text = told(with_alternative(crl(ca), ca))
    for words in (
        "Revocation list of CN=Lab CA",
        "due 2026-06-08 00:00:00 UTC (in 7 days)",
        "serial 2 on 2026-06-01 00:00:00 UTC: its key was compromised",
        "alternative signature  ml-dsa-65 (not verified)",
    ):
        assert words in text
    assert "3 days ago: this one is out of date" in told(crl(ca), now=NOW + timedelta(days=10))


def test_keys_that_pqsec_cannot_use_are_named():
    edwards = ed25519.Ed25519PrivateKey.generate()
    der = edwards.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
    assert "Ed25519, unusable here" in told(der)
    large = ec.generate_private_key(ec.SECP521R1())
    der = large.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
    assert "an elliptic curve, unusable here" in told(der)


def test_a_public_key_is_told():
    assert "ml-dsa-65 (post-quantum" in told(key("ml-dsa-65").public_key.spki)
    assert told(pem("PUBLIC KEY", key("p256").public_key.spki)).startswith("Public key")


def test_several_things_in_one_file_are_told_in_turn():
    data = b"notes\n" + participant().pem + private_key_pem(key("p256")) + pem("DH STUFF", b"1")
    values = fields(data)
    assert values["title"] == "3 things in one file"
    assert [part["kind"] for part in values["parts"]] == ["certificate", "private key", "unknown"]


def test_a_governance_document_is_told_in_words():
    text = told(governance())
    for words in (
        "Governance document, unsigned",
        "domains 0,7",
        "who may join: only participants with a certificate and permissions for the domain",
        "rtps (whole messages): signed",
        "topics *",
        "write: only with permission",
        "data: encrypted",
    ):
        assert words in text


def test_a_permissions_document_is_told_in_words():
    lines = told(permissions()).splitlines()
    assert [line.strip() for line in lines[2:]] == [
        "grant 1     subject: CN=/talker",
        "name: g",
        "validity: 2026-06-01 00:00:00 UTC to 2026-06-04 00:00:00 UTC (3 days left)",
        "deny on domain 0",
        "publish: topics rt/secret*",
        "allow on domains 0-5",
        'publish: topics rt/chatter in partitions "" (the default), lab with data tags room=east',
        "everything else: deny",
    ]


@pytest.mark.parametrize("embed", [True, False])
def test_the_signatures_of_a_document_are_told_and_not_believed(embed):
    signer, counter = authority(), authority("ml-dsa-65")
    message = sign(
        permissions(),
        Signer(signer.certificate, signer.key),
        countersigner=Signer(counter.certificate, counter.key),
        embed_certificate=embed,
        now=NOW,
    )
    text, values = told(message), fields(message)
    assert "not verified; `pqsec verify` does that" in text
    assert values["verified"] is False
    [found] = values["signatures"]
    assert found["serial"] == f"{signer.certificate.serial_number:x}"
    assert (found["issuer"], found["algorithm"]) == ("CN=Lab CA", "ECDSA with SHA-256")
    [countersignature] = found["countersignatures"]
    assert countersignature["algorithm"] == "ml-dsa-65"
    assert len(values["embedded_certificates"]) == embed
    assert values["grants"][0]["subject"] == "CN=/talker"


def test_a_signed_document_that_breaks_its_schema_is_told_with_what_is_wrong():
    broken = permissions().replace(b"<default>DENY</default>", b"")
    message = sign(broken, Signer(authority().certificate, authority().key), now=NOW)
    assert "<grant>: is not complete" in told(message)
    with pytest.raises(InvalidDocumentError, match="is not complete"):
        describe(broken, now=NOW)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "an empty file"),
        (b"hello", "of no known kind"),
        (b"0\x03\x02\x01\x01", "DER of an unknown kind"),
        (b"-----BEGIN DH STUFF-----\nMAA=\n-----END DH STUFF-----\n", "DH STUFF"),
        (b"-----BEGIN CERTIFICATE-----\nMAA=\n", "no END line"),
        (b"Content-Type: application/pkcs7-mime\n\nMAA=", "opaque S/MIME"),
    ],
)
def test_what_is_nothing_known_is_refused_with_a_hint(data, words):
    with pytest.raises(MalformedError, match=words) as refused:
        describe(data, now=NOW)
    assert refused.value.hint or "END" in words


def test_control_characters_from_a_file_never_reach_a_terminal():
    description = Description("x", "a\x1b[2Jb", (Fact.of("c", "d\re\u202e"),))
    assert description.to_text() == ["a\\u001b[2Jb", "  c  d\\u000de\\u202e"]


@pytest.mark.interop
def test_what_openssl_makes_is_told(requires, tmp_path):
    openssl = requires(shutil.which("openssl"), "OpenSSL", "apt install openssl")

    def run(*words):
        return subprocess.run(
            [openssl, *words], cwd=tmp_path, capture_output=True, check=True
        ).stdout

    certificate = run(
        *("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "key", "-text"),
        *("-subj", "/O=Lab/CN=OpenSSL CA", "-addext", "extendedKeyUsage=clientAuth"),
    )
    text = told(certificate)
    assert "CA certificate: CN=OpenSSL CA,O=Lab" in text
    assert "rsa-2048 (classical" in text
    assert "extended key usage: TLS client" in text
    private = fields((tmp_path / "key").read_bytes())
    assert private["public_key_sha256"] == fields(certificate)["public_key_sha256"]
    request = run("req", "-new", "-key", "key", "-subj", "/CN=talker")
    assert "verified: the requester has the private key" in told(request)
    (tmp_path / "ca").write_bytes(certificate)
    (tmp_path / "xml").write_bytes(governance())
    words = ("cms", "-sign", "-text", "-keyid", "-nocerts", "-signer", "ca", "-inkey", "key")
    text = told(run(*words, "-in", "xml"))
    assert "by the certificate with key identifier" in text
    assert "none; stock DDS stacks need" in text
    assert "EC PARAMETERS" in told(run("ecparam", "-name", "prime256v1", "-genkey"))
