"""What real stacks made of a variant, and what the check says of it: they agree.

Each row of tests/docs/measured.json is a variant that two processes tried to talk with, in
three versions of Cyclone DDS and then three of Fast DDS. They are made again here, and an
error is told for a stack if one of its versions refused the variant, and else none.
"""

import re
from datetime import UTC, datetime

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, mldsa, padding
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    pkcs7,
)
from cryptography.x509.oid import ExtendedKeyUsageOID

from pqsec_pki.documents import DomainSet, Governance, Grant, Permissions
from pqsec_pki.lint import Severity, check
from pqsec_pki.stacks import Stack
from tests.docs.rules_page import MEASURED as ROWS
from tests.some_keys import rsa_key
from tests.unit.keystores import DAY, NOW
from tests.unit.linting import YEAR, certificate, p256, usage

PQSECS_OWN = "PQS319"
"""What pqsec does not trust, though stacks may."""
VERDICTS = {row["variant"]: row["verdicts"] for row in ROWS}
OPTION = pkcs7.PKCS7Options
TEXT, DETACHED = OPTION.Text, OPTION.DetachedSignature
UNKNOWN = x509.UnrecognizedExtension(x509.ObjectIdentifier("1.2.3.4"), b"\5\0")
SERVER = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
MAIL = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.EMAIL_PROTECTION])
P384, ED25519 = ec.generate_private_key(ec.SECP384R1()), ed25519.Ed25519PrivateKey.generate()
ALTERNATIVE = x509.UnrecognizedExtension(x509.ObjectIdentifier("2.5.29.73"), b"\5\0")
PSS = {"rsa_padding": padding.PSS(padding.MGF1(hashes.SHA256()), 32)}
SIGN = usage("digital_signature")
OVER = {"begin": NOW - 9 * DAY, "end": NOW - DAY}
BARE = {"constraints": False, "use": "none", "identifiers": False}


def site(  # noqa: PLR0913 -- each is something to get wrong
    folder, *, identity=None, permissions=None, own=None, files=None, document=None, **signing
):
    """An enclave as others make it, sound but for what is given."""
    identity = with_key({"name": "Identity CA", "key": p256(), "ca": True} | (identity or {}))
    permissions = {"name": "Permissions CA", "key": p256(), "ca": True} | (permissions or {})
    permissions = with_key(permissions)
    own = {"issuer": identity["name"], "signer": identity["key"], "key": p256()} | (own or {})
    own = with_key(own)
    authority, document = certificate(**permissions), document or PERMISSIONS
    made = {
        "identity_ca.cert.pem": certificate(**identity),
        "permissions_ca.cert.pem": authority,
        "cert.pem": certificate(**own),
        "key.pem": private(own["key"]),
        "permissions.p7s": signed(document, authority, permissions["key"], **signing),
        "governance.p7s": signed(GOVERNANCE, authority, permissions["key"], **signing),
    }
    made |= {name: change(made[name]) for name, change in (files or {}).items()}
    for name, data in made.items():
        (folder / name).write_bytes(data)
    (folder / "key.pem").chmod(0o600)


GOVERNANCE = Governance.protected(DomainSet.of(0)).to_xml()
PERMISSIONS = Permissions(
    grants=(
        Grant.least(
            subject_name="CN=/talker", not_before=NOW - DAY, not_after=NOW + YEAR,
            domains=DomainSet.of(0), publish=("rt/chatter",), subscribe=(),
        ),
    )
).to_xml()  # fmt: skip


def private(key, form=PrivateFormat.PKCS8, encryption=None):
    return key.private_bytes(Encoding.PEM, form, encryption or NoEncryption())


def signed(  # noqa: PLR0913 -- each is something to get wrong
    xml, authority, key, *, options=(TEXT, DETACHED), digest=hashes.SHA256, change=None
):
    if isinstance(key, ed25519.Ed25519PrivateKey):
        key, authority = p256(), certificate("Permissions CA", ca=True)  # no signer does it
    ca = x509.load_pem_x509_certificate(authority)
    builder = pkcs7.PKCS7SignatureBuilder().set_data(xml).add_signer(ca, key, digest())
    text = builder.sign(Encoding.SMIME, options)
    return change(text) if change else text


def replaced(old, new):
    """Signing, and then an edit."""

    def change(text):
        assert old in text
        return text.replace(old, new)

    return {"change": change}


def some_rsa(bits, owner="alice"):
    """A key that is made when a test uses it: each worker reads all cases, and runs some."""
    return lambda: rsa_key(bits, owner)


def with_key(more):
    found = more["key"]
    return more | {"key": found() if callable(found) else found}


def has_hash(key):
    return not isinstance(key, ed25519.Ed25519PrivateKey | mldsa.MLDSA65PrivateKey)


def key(key, **more):
    return {"key": key} | ({} if has_hash(key) else {"digest": False}) | more


def before(more):
    return lambda text: more + text


def behind(more):
    return lambda text: text + more


def cas(change):
    return {"files": {"identity_ca.cert.pem": change}}


def keys(make):
    return {"files": {"key.pem": lambda _: make()}}


ROOT, MIDDLE = p256(), p256()
BELOW = {"name": "Middle CA", "ca": True, "key": MIDDLE, "issuer": "Identity CA", "signer": ROOT}
BELOW_ROOT = {"identity": {"key": ROOT}, "own": {"issuer": "Middle CA", "signer": MIDDLE}}
ML_DSA = mldsa.MLDSA65PrivateKey.generate()
ROLES = ("identity", "permissions", "own")
PASSWORD = BestAvailableEncryption(b"Correct-Horse_1")
LONG = PERMISSIONS.replace(b"<default>", b"<!--" + b"x" * (512 << 10) + b"--><default>")

MEASURED = {
    "all P-256, SHA-256 (baseline)": [{}],
    "all RSA-2048": [{each: key(some_rsa(2048, each)) for each in ROLES}],
    "identity CA P-384, leaf P-256": [{"identity": key(P384)}],
    "leaf P-384": [{"own": key(P384)}],
    "all RSA-3072": [{each: key(some_rsa(3072, each)) for each in ROLES}],
    "identity CA Ed25519": [{"identity": key(ED25519), "own": {"digest": False}}],
    "leaf Ed25519": [{"own": key(ED25519, digest=None)}],
    "permissions CA P-384": [{"permissions": key(P384)}],
    "permissions CA RSA-2048 / 3072 / 4096 (same verdicts)": [
        {"permissions": key(some_rsa(bits))} for bits in (2048, 3072)
    ],
    "permissions CA Ed25519 (CMS by OpenSSL 3.5)": [{"permissions": key(ED25519)}],
    "leaf brainpoolP256r1 / secp256k1 (wrongly let in)": [
        {"own": key(ec.generate_private_key(curve))}
        for curve in (ec.BrainpoolP256R1(), ec.SECP256K1())
    ],
    "certs signed ecdsa-with-SHA384 or SHA512": [
        {"own": {"digest": hashes.SHA384()}}, {"identity": {"digest": hashes.SHA512()}},
    ],
    "certs signed RSASSA-PSS": [{"identity": key(some_rsa(2048), **PSS)}],
    "S/MIME digest SHA-384 / SHA-512": [{"digest": hashes.SHA384}, {"digest": hashes.SHA512}],
    "same, whole file LF": [replaced(b"\r\n", b"\n")],
    "no Text flag (`Detached` only)": [{"options": (DETACHED,)}],
    "`Detached+Binary`": [{"options": (DETACHED, OPTION.Binary)}],
    "no DetachedSignature (opaque)": [{"options": ()}],
    "`NoCapabilities`": [{"options": (TEXT, DETACHED, OPTION.NoCapabilities)}],
    "`NoAttributes`": [{"options": (TEXT, DETACHED, OPTION.NoAttributes)}],
    "`NoCerts`": [{"options": (TEXT, DETACHED, OPTION.NoCerts)}],
    "inner `text/xml` or `application/xml`": [
        replaced(b"text/plain", kind) for kind in (b"text/xml", b"application/xml")
    ],
    "inner Content-Type absent": [replaced(b"Content-Type: text/plain\r\n", b"")],
    "micalg `sha256` / absent / wrong `md5`": [
        replaced(b' micalg="sha-256";', new) for new in (b' micalg="sha256";', b"", b" micalg=md5;")
    ],
    "`application/pkcs7-signature` (no x-)": [replaced(b"x-pkcs7", b"pkcs7")],
    "no MIME-Version / no preamble / extra mail headers / unquoted boundary": [
        replaced(b"MIME-Version: 1.0\r\n", b""),
        {"change": before(b"From: me\r\nTo: you\r\n")},
        {"change": lambda text: re.sub(rb'boundary="([^"]+)"', rb"boundary=\1", text)},
    ],
    "blank first line": [{"change": before(b"\r\n")}],
    "tampered": [replaced(b"</dds>", b"</dds >")],
    "KU keyCertSign+cRLSign only (no digitalSignature)": [
        {"permissions": {"use": usage("key_cert_sign", "crl_sign")}}
    ],
    "KU digitalSignature only": [{"permissions": {"use": SIGN}}],
    "no KU / BC non-critical / BC CA:FALSE+digSig / no extensions at all": [
        {"permissions": flaw} for flaw in ({"use": "none"}, {"ca": False, "use": SIGN}, BARE)
    ],
    "EKU serverAuth": [{"permissions": {"extensions": [(SERVER, False)]}}],
    "EKU emailProtection": [{"permissions": {"extensions": [(MAIL, False)]}}],
    "permissions CA expired": [{"permissions": OVER}],
    "CA without any extension": [{"identity": BARE}],
    "CA KU without keyCertSign": [{"identity": {"use": usage("crl_sign")}}],
    "CA no KU, or BC non-critical, or pathlen 0": [{"identity": {"use": "none"}}],
    "leaf: no ext / KU keyAgreement / any EKU (even critical) / BC CA:TRUE": [
        {"own": flaw}
        for flaw in (
            BARE, {"use": usage("key_agreement")}, {"extensions": [(SERVER, True)]}, {"ca": True},
        )
    ],
    "leaf: unknown critical extension": [{"own": {"extensions": [(UNKNOWN, True)]}}],
    "leaf: unknown non-critical extension": [{"own": {"extensions": [(UNKNOWN, False)]}}],
    "leaf expired / not yet valid; CA expired": [
        {"own": OVER}, {"own": {"begin": NOW + DAY}}, {"identity": OVER},
    ],
    "cert notAfter 9999 (or 2500)": [
        {"own": {"end": datetime(year, 12, 31, tzinfo=UTC)}} for year in (9999, 2500)
    ],
    "identity_ca=root, cert.pem=leaf+intermediate": [
        BELOW_ROOT | {"files": {"cert.pem": behind(certificate(**BELOW))}}
    ],
    "identity_ca=root+int, cert=leaf": [BELOW_ROOT | cas(behind(certificate(**BELOW)))],
    "identity_ca=int+root, cert=leaf (no AKI)": [BELOW_ROOT | cas(before(certificate(**BELOW)))],
    "identity_ca=int only": [BELOW_ROOT | cas(lambda _: certificate(**BELOW))],
    "two CAs in file, right one second": [cas(before(certificate("Other CA", ca=True)))],
    "PEM with CRLF / text preamble": [
        {"files": {"cert.pem": lambda text: text.replace(b"\n", b"\r\n")}},
        {"files": {"cert.pem": before(b"Certificate:\n")}},
    ],
    "key does not match cert": [keys(lambda: private(p256()))],
    "PKCS#8 PBES2 + password": [keys(lambda: private(p256(), encryption=PASSWORD))],
    "traditional PEM, encrypted or not": [
        keys(lambda: private(p256(), PrivateFormat.TraditionalOpenSSL, PASSWORD))
    ],
    "cert with empty subject": [{"own": {"name": ""}}],
    "subset `CN=x` only": [{"own": {"name": "/talker/more"}}],
    "permissions document 512 KB": [{"document": LONG}],
    "alt extensions marked critical": [{"own": {"extensions": [(ALTERNATIVE, True)]}}],
    "identity all ML-DSA-65": [{"identity": key(ML_DSA), "own": key(ML_DSA)}],
    "ML-DSA CA, EC leaf": [{"identity": key(ML_DSA), "own": {"digest": False}}],
    "EC CA, ML-DSA leaf": [{"own": key(ML_DSA, digest=None)}],
}  # fmt: skip
CASES = [
    pytest.param(row, variant, id=row) for row, variants in MEASURED.items() for variant in variants
]


def has_error(folder, target):
    findings = check([folder], now=NOW, targets=[target]).findings
    theirs = (each.rule for each in findings if each.rule.id != PQSECS_OWN)
    return any(rule.severity is Severity.ERROR for rule in theirs)


@pytest.mark.parametrize(("row", "variant"), CASES)
def test_an_error_is_told_to_those_whose_stack_refuses(tmp_path, row, variant):
    site(tmp_path, **variant)
    cyclonedds, fastdds = VERDICTS[row][:3], VERDICTS[row][3:]
    assert has_error(tmp_path, Stack.CYCLONEDDS) is bool({"R", "X"} & set(cyclonedds))
    assert has_error(tmp_path, Stack.FASTDDS) is bool({"R", "X"} & set(fastdds))
