"""The rules about certificates and revocation lists: each sees its flaw, one step from sound."""

import shutil
from datetime import UTC, datetime

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, padding
from cryptography.x509.oid import ExtendedKeyUsageOID

from pqsec_pki._asn1 import Signed, TBSCertList, bits, decode, encode, raw
from pqsec_pki.algorithms import SIGNATURES, pem, unpem
from pqsec_pki.certificates import Authority
from pqsec_pki.stacks import Stack
from tests.some_keys import rsa_key
from tests.unit.keystores import DAY, NOW
from tests.unit.linting import (
    TALKER,
    YEAR,
    Lab,
    certificate,
    found,
    issuers_identifier,
    named,
    p256,
    usage,
)
from tests.unit.version_1 import in_version_1

OWN, IDENTITY, PERMISSIONS = "cert.pem", "identity_ca.cert.pem", "permissions_ca.cert.pem"
CRL = "public/identity_ca.crl.pem"
CA_KEY = p256()
PSS = {"rsa_padding": padding.PSS(padding.MGF1(hashes.SHA256()), 32)}
UNKNOWN = x509.UnrecognizedExtension(x509.ObjectIdentifier("1.2.3.4"), b"\5\0")
ALTERNATIVE = x509.UnrecognizedExtension(
    x509.ObjectIdentifier("2.5.29.72"),
    p256().public_key().public_bytes(
        serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
    ),
)  # fmt: skip
SERVER = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
MAIL = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.EMAIL_PROTECTION])
NETSCAPE = x509.UnrecognizedExtension(
    x509.ObjectIdentifier("2.16.840.1.113730.1.1"), bytes.fromhex("030205a0")
)
SAN = x509.SubjectAlternativeName([x509.DNSName("robot")])
CERT_SIGN = usage("key_cert_sign", "crl_sign")
SIGN = usage("digital_signature")
SHA256_WITH_RSA, SHA1_WITH_RSA = (bytes.fromhex(f"2a864886f70d0101{n}") for n in ("0b", "05"))


def own(**flaw):
    """A participant's certificate, under a CA of another name."""
    return OWN, certificate(**({"issuer": "Identity CA", "signer": CA_KEY} | flaw))


def ca(name=IDENTITY, **flaw):
    return name, certificate(**({"name": "Some CA", "ca": True} | flaw))


def permissions_ca(**flaw):
    return ca(PERMISSIONS, **flaw)


def key(kind):
    return own(key=kind)


def ed(**more):
    return {"key": ed25519.Ed25519PrivateKey.generate(), "digest": False} | more


def end_of(year):
    return datetime(year, 12, 31, tzinfo=UTC)


def with_sha1():
    [(_, der)] = unpem(certificate(key=rsa_key(2048)), "certificate")
    return OWN, pem("CERTIFICATE", der.replace(SHA256_WITH_RSA, SHA1_WITH_RSA))


def garbled():
    name, text = own()
    return name, text + pem("CERTIFICATE", b"\x30\x03\x02\x01\x05")


def old(name):
    made = Authority.create("Some CA", SIGNATURES.named("ecdsa-p256"), now=NOW, validity=YEAR)
    return name, in_version_1(made.certificate, made.key).pem


def forged():
    """A CA that another one of its name signed."""
    return ca(signer=p256())


def p384():
    return ec.generate_private_key(ec.SECP384R1())


def p521():
    return ec.generate_private_key(ec.SECP521R1())


# Rule -> files that break it, each made when it is asked for.
FLAWED = {
    "PQS101": [lambda: key(p384()), lambda: ca(key=p384()),
               lambda: key(rsa_key(3072)),
               lambda: key(p521())],
    "PQS102": [lambda: own(**ed(digest=None)), lambda: ca(**ed()), lambda: permissions_ca(**ed())],
    "PQS103": [lambda: key(ec.generate_private_key(ec.BrainpoolP256R1())),
               lambda: key(ec.generate_private_key(ec.SECP256K1()))],
    "PQS104": [lambda: own(digest=hashes.SHA384()), lambda: ca(digest=hashes.SHA512()),
               lambda: ca(key=rsa_key(2048), **PSS),
               lambda: permissions_ca(key=rsa_key(2048), **PSS)],
    "PQS105": [with_sha1],
    "PQS106": [lambda: key(rsa_key(1024)),
               lambda: key(ec.generate_private_key(ec.SECP224R1()))],
    "PQS107": [lambda: own(name="")],
    "PQS110": [lambda: own(end=NOW - DAY / 24), lambda: ca(end=NOW - DAY / 24),
               lambda: permissions_ca(end=NOW - DAY / 24)],
    "PQS111": [lambda: own(end=NOW + 29 * DAY, begin=NOW - YEAR),
               lambda: own(end=NOW + DAY, begin=NOW - 9 * DAY)],
    "PQS112": [lambda: own(begin=NOW + DAY / 24)],
    "PQS113": [lambda: own(end=end_of(2262)), lambda: ca(end=end_of(9999))],
    "PQS120": [lambda: ca(constraints=False, use="none"), lambda: ca("ca.cert.pem", ca=False)],
    "PQS121": [lambda: permissions_ca(ca=False), lambda: permissions_ca(constraints=False)],
    "PQS122": [lambda: ca(use=usage("digital_signature", "crl_sign"))],
    "PQS123": [lambda: permissions_ca(use=SIGN)],
    "PQS124": [lambda: permissions_ca(use=CERT_SIGN), lambda: ca("ca.cert.pem", use=CERT_SIGN)],
    "PQS125": [lambda: permissions_ca(extensions=[(SERVER, False)])],
    "PQS126": [lambda: own(extensions=[(UNKNOWN, True)]),
               lambda: own(identifiers=False, extensions=[(issuers_identifier(CA_KEY), True)])],
    "PQS127": [lambda: own(extensions=[(ALTERNATIVE, True)])],
    "PQS128": [lambda: own(ca=True)],
    "PQS129": [lambda: own(use=usage("key_agreement"))],
    "PQS130": [garbled],
    "PQS131": [lambda: (IDENTITY, ca()[1] + ca(name="Other CA")[1]),
               lambda: (OWN, own()[1] + ca()[1])],
    "PQS132": [lambda: ca(issuer="Root", signer=CA_KEY), forged,
               lambda: permissions_ca(issuer="Root", signer=CA_KEY),
               lambda: permissions_ca(key=p521(), signer=p521()),
               lambda: ca(key=rsa_key(2048), signer=rsa_key(1024), **PSS)],
    "PQS133": [lambda: own(identifiers=False), lambda: ca(identifiers=False)],
    "PQS134": [lambda: old(IDENTITY), lambda: old(PERMISSIONS), lambda: old("ca.cert.pem")],
}  # fmt: skip
# What else is told of them, rightly.
AND_ALSO = {
    "PQS106": {"PQS101"},
    "PQS120": {"PQS122"},
    "PQS132": {"PQS104"},
    "PQS134": {"PQS133"},
}
# What is one step from a flaw, and none. Measured to be taken, or harmless.
SOUND = {
    "participant": own,
    "identity CA": ca,
    "permissions CA": permissions_ca,
    "one CA": lambda: ca("ca.cert.pem"),
    "RSA-2048": lambda: own(key=rsa_key(2048)),
    "RSA-2048 CA": lambda: ca(key=rsa_key(2048)),
    "P-384 permissions CA, signed with SHA-256": lambda: permissions_ca(key=p384()),
    "RSA-3072 permissions CA": lambda: permissions_ca(key=rsa_key(3072)),
    "P-521 permissions CA, which was not measured": lambda: permissions_ca(key=p521()),
    "far from its end": lambda: own(end=NOW + 31 * DAY, begin=NOW - YEAR),
    "short-lived and young": lambda: own(end=NOW + 3 * DAY),
    "begins now": lambda: own(begin=NOW),
    "ends in 2261": lambda: ca(end=end_of(2261)),
    "permissions CA, no keyUsage": lambda: permissions_ca(use="none"),
    "identity CA, certSign only": lambda: ca(use=CERT_SIGN),
    "for mail": lambda: permissions_ca(extensions=[(MAIL, False)]),
    "identity CA for servers": lambda: ca(extensions=[(SERVER, True)]),
    "leaf for servers": lambda: own(extensions=[(SERVER, True)]),
    "unknown, not critical": lambda: own(extensions=[(UNKNOWN, False)]),
    "critical and known": lambda: own(extensions=[(SAN, True), (NETSCAPE, True)]),
    "alternative, not critical": lambda: own(extensions=[(ALTERNATIVE, False)]),
    "no keyUsage": lambda: own(use="none"),
    "CRLF": lambda: (OWN, own()[1].replace(b"\n", b"\r\n")),
    "text before it": lambda: (OWN, b"Certificate of the talker\n" + own()[1]),
}
CASES = [(rule, make) for rule, makers in FLAWED.items() for make in makers]


def found_in(folder, made, *targets):
    name, text = made
    (folder / name).write_bytes(text)
    return found(folder / name, targets=targets)


@pytest.mark.parametrize(("rule", "make"), CASES, ids=[rule for rule, _ in CASES])
def test_a_flaw_is_found(tmp_path, rule, make):
    assert set(found_in(tmp_path, make())) - AND_ALSO.get(rule, set()) == {rule}


def test_every_curve_below_256_bits_is_weak(tmp_path):
    """P-224, and those that the library makes no keys of: the certificate says another curve."""
    name, text = key(ec.generate_private_key(ec.SECP224R1()))
    [(_, der)] = unpem(text, "certificate")
    for last, curve in ((0x21, "ecdsa-p224"), (0x20, "secp224k1"), (0x1F, "secp192k1")):
        other = der.replace(bytes.fromhex("06052b81040021"), bytes([6, 5, 0x2B, 0x81, 4, 0, last]))
        told = found_in(tmp_path, (name, pem("CERTIFICATE", other)))
        assert told["PQS106"].message == f"the key of the participant is weak: {curve}"


@pytest.mark.parametrize("make", SOUND.values(), ids=SOUND)
def test_what_stacks_take_is_not_complained_of(tmp_path, make):
    assert found_in(tmp_path, make()) == {}


@pytest.mark.parametrize(
    ("rule", "target"),
    [("PQS101", Stack.FASTDDS), ("PQS104", Stack.CYCLONEDDS), ("PQS113", Stack.OPENDDS)],
)
def test_what_one_stack_minds_is_not_told_to_the_others(tmp_path, rule, target):
    made = FLAWED[rule][0]()
    assert rule in found_in(tmp_path, made)
    assert rule not in found_in(tmp_path, made, target)


@pytest.mark.parametrize("format_", ["PKCS8", "TraditionalOpenSSL"])
def test_ros_2_cannot_open_encrypted_keys(tmp_path, format_):
    text = CA_KEY.private_bytes(
        serialization.Encoding.PEM,
        getattr(serialization.PrivateFormat, format_),
        serialization.BestAvailableEncryption(b"secret"),
    )
    (tmp_path / "key.pem").write_bytes(text)
    (tmp_path / "key.pem").chmod(0o600)
    assert "PQS150" in found(tmp_path, targets=[Stack.ROS2])
    assert "PQS150" not in found(tmp_path)
    assert "PQS150" not in found(tmp_path, targets=[Stack.CYCLONEDDS])


def crl(
    *serials, issuer="Test Identity CA", key=CA_KEY, begin=NOW - DAY, end=NOW + YEAR, **options
):
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(named(issuer))
        .last_update(begin)
        .next_update(end)
    )
    for number in serials:
        entry = x509.RevokedCertificateBuilder(number, NOW - DAY).build()
        builder = builder.add_revoked_certificate(entry)
    return builder.sign(key, hashes.SHA256(), **options).public_bytes(serialization.Encoding.PEM)


def endless(key):
    """A list without nextUpdate, which the library does not make."""
    [(_, der)] = unpem(crl(key=key), "revocation list")
    signed = decode(Signed, der, "list")
    tbs = decode(TBSCertList, encode(signed.tbs), "list")
    tbs.next_update = None
    content = encode(tbs)
    signature = key.sign(content, ec.ECDSA(hashes.SHA256()))
    whole = Signed(
        tbs=raw(content), signature_algorithm=signed.signature_algorithm, signature=bits(signature)
    )
    return pem("X509 CRL", encode(whole))


@pytest.fixture
def lab(tmp_path):
    return Lab(tmp_path, "classical")


def give(lab, text, names=("talker", "listener")):
    """The list to these participants, as `pqsec revoke` does."""
    lab.put(CRL, text)
    for name in names:
        (lab / f"enclaves/{name}/crl.pem").symlink_to(f"../../{CRL}")


def ca_key(lab):
    return lab.authorities().identity.key.handle


def serial(lab):
    return x509.load_pem_x509_certificate((lab / TALKER / OWN).read_bytes()).serial_number


@pytest.mark.parametrize(
    ("rule", "flaw"),
    [
        ("PQS140", lambda lab: pem("X509 CRL", b"\x30\0")),
        ("PQS141", lambda lab: crl(key=ca_key(lab), end=NOW - DAY / 24)),
        ("PQS148", lambda lab: crl(key=ca_key(lab), begin=NOW - YEAR, end=NOW + 9 * DAY)),
        ("PQS142", lambda lab: crl(key=ca_key(lab), begin=NOW + DAY / 24)),
        ("PQS143", lambda lab: endless(ca_key(lab))),
        ("PQS145", lambda lab: crl(key=p256())),
        ("PQS145", lambda lab: crl(key=ca_key(lab), issuer="Other CA")),
        ("PQS149", lambda lab: crl(serial(lab), key=ca_key(lab))),
    ],
)
def test_a_flaw_of_a_revocation_list_is_found(lab, rule, flaw):
    give(lab, flaw(lab))
    assert set(lab.found()) == {rule}


def test_a_revoked_participant_is_found_where_it_runs(lab, tmp_path):
    give(lab, crl(serial(lab), key=ca_key(lab)))
    for name in ("talker", "listener"):
        shutil.copytree(lab / f"enclaves/{name}", tmp_path / name, symlinks=False)
    assert "PQS146" in found(tmp_path / "talker")
    assert "PQS146" not in found(tmp_path / "listener")


def test_who_has_no_revocation_list_or_an_old_one_is_found(lab):
    give(lab, crl(key=ca_key(lab)), names=["listener"])
    finding = lab.found()["PQS317"]
    assert finding.path.name == "talker"
    assert "has no revocation list; /listener has one" in finding.message
    lab.put(f"{TALKER}/crl.pem", crl(key=ca_key(lab), begin=NOW - 2 * DAY))
    assert "has a revocation list of 2026-11-19" in lab.found()["PQS317"].message
    lab.put(f"{TALKER}/crl.pem", (lab / CRL).read_bytes())
    assert lab.found() == {}


def test_a_revocation_list_among_certificates_is_found(lab):
    path = lab / "public" / IDENTITY
    path.write_bytes(path.read_bytes() + crl(key=ca_key(lab)))
    assert set(lab.found()) == {"PQS144", "PQS319"}


@pytest.mark.parametrize("end", [NOW + YEAR, NOW + 2 * DAY])
def test_a_good_revocation_list_is_not_complained_of(lab, end):
    give(lab, crl(serial(lab) + 1, key=ca_key(lab), end=end))
    assert lab.found() == {}


def test_of_a_list_that_cannot_be_checked_nothing_false_is_said(lab):
    text = certificate("Test Identity CA", key=rsa_key(2048), ca=True)
    lab.put(f"public/{IDENTITY}", text)
    give(lab, crl(key=rsa_key(2048), **PSS))
    assert "PQS145" not in lab.found()
    lab.put(CRL, crl(key=rsa_key(2048), issuer="Other CA", **PSS))
    assert "PQS145" in lab.found()


def test_opendds_reads_no_revocation_list(lab):
    give(lab, crl(key=ca_key(lab)))
    assert "PQS147" in lab.found(Stack.OPENDDS)
    assert lab.found() == {}
