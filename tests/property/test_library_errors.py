"""Whatever a library raises on bytes from outside is our error, and the library's is its cause.

Each library is made to raise errors that it does not document, at the call that reads the bytes.
"""

import tarfile
import zlib
from datetime import UTC, datetime, timedelta

import pytest
import yaml
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from lxml import etree

from pqsec_pki import _asn1
from pqsec_pki.algorithms import (
    KEY_AGREEMENTS,
    SIGNATURES,
    keys,
    load_private_key,
    load_public_key,
)
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    CertificateRequest,
    RevocationList,
    certificate_request,
    revocation_list,
)
from pqsec_pki.documents import DomainSet, Governance, Permissions, _schema, read_tree
from pqsec_pki.documents._yaml import parse
from pqsec_pki.enrolment import tarball
from pqsec_pki.errors import InvalidDocumentError, MalformedError, PqsecError, VerificationError

NOW = datetime(2026, 11, 28, tzinfo=UTC)


class PanicException(BaseException):
    """As a panic of Rust reaches Python: it is no Exception."""


ERRORS = [
    KeyError(24),
    TypeError("NoneType"),
    OverflowError("int too large"),
    RecursionError("maximum recursion depth exceeded"),
    UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
    AssertionError(),
    PanicException("called `Option::unwrap()` on a `None` value"),
]


ROW, AGREEMENT = SIGNATURES.named("ecdsa-p256"), KEY_AGREEMENTS.named("ml-kem-768")
CA = Authority.create("Lab", ROW, now=NOW, validity=timedelta(9))
LIST = revocation_list(CA, [], number=1, now=NOW, validity=timedelta(9))
REQUEST = certificate_request("/robot", ROW.generate())
GOVERNANCE = Governance.protected(DomainSet.of(0)).to_xml()
COMMENTED = GOVERNANCE.replace(b"<domains>", b"<!-- x --><domains>")
ARCHIVE = tarball.pack({"a": b"b"})
SPKI, PKCS8 = CA.key.public_key.spki, CA.key.pkcs8
COMPOSITE = SIGNATURES.named("mldsa65-ecdsa-p256-sha512")
COMPOSITE_SPKI = COMPOSITE.generate().public_key.spki
PAIR = AGREEMENT.generate()
DH2, _ = AGREEMENT.encapsulate(PAIR.public)


CALLS = {
    "a certificate": (
        x509,
        "load_der_x509_certificate",
        lambda: Certificate.from_der(CA.certificate.der),
    ),
    "a list": (x509, "load_der_x509_crl", lambda: RevocationList.from_der(LIST.der)),
    "a request": (x509, "load_der_x509_csr", lambda: CertificateRequest.from_der(REQUEST.der)),
    "attributes": (x509, "load_der_x509_csr", lambda: REQUEST.challenge_password),
    "any DER": (_asn1.asn1, "decode_der", lambda: _asn1.decode(int, b"\2\1\0", "number")),
    "raw DER": (_asn1.asn1, "decode_der", lambda: _asn1.raw(b"\2\1\0")),
    "a public key": (keys, "load_der_public_key", lambda: load_public_key(SPKI)),
    "a composite key": (
        type(COMPOSITE),
        "load_raw_public",
        lambda: load_public_key(COMPOSITE_SPKI),
    ),
    "a private key": (keys, "load_der_private_key", lambda: load_private_key(PKCS8)),
    "a signature": (type(ROW), "check", lambda: CA.key.public_key.verify(b"", b"", ROW.identifier)),
    "one of a message": (
        *(type(ROW), "check_handshake"),
        lambda: CA.key.public_key.verify_handshake(b"", b""),
    ),
    "dh1": (type(AGREEMENT), "_encapsulate", lambda: AGREEMENT.encapsulate(PAIR.public)),
    "dh2": (type(AGREEMENT), "_decapsulate", lambda: PAIR.decapsulate(DH2)),
    "a document": (etree, "fromstring", lambda: Permissions.from_xml(COMMENTED)),
    "its schema": (_schema, "_schema", lambda: Governance.from_xml(COMMENTED)),
    "its tree": (etree, "fromstring", lambda: read_tree(COMMENTED)),
    "YAML": (yaml, "parse", lambda: parse(b"a: b")),
    "an archive": (tarfile, "open", lambda: tarball.unpack(ARCHIVE)),
    "its compression": (zlib, "decompressobj", lambda: tarball.unpack(ARCHIVE)),
}
REFUSALS = MalformedError | VerificationError | InvalidDocumentError


class Raising:
    """In place of what a library gives: each call on it raises."""

    def __init__(self, error):
        self.error = error

    def __getattr__(self, name):
        raise self.error


@pytest.fixture
def raising(monkeypatch):
    """raising("a list", error) lets the library raise it, and gives what pqsec raises then."""

    def raised(what, error):
        owner, name, call = CALLS[what]
        if name in {"_schema", "decompressobj"}:
            monkeypatch.setattr(owner, name, lambda *_, **__: Raising(error))
        else:
            monkeypatch.setattr(owner, name, lambda *_, **__: (_ for _ in ()).throw(error))
        with pytest.raises(BaseException) as found:
            call()
        return found.value

    return raised


@pytest.mark.parametrize("what", CALLS)
def test_whatever_a_library_raises_becomes_our_error(raising, what):
    for error in ERRORS:
        found = raising(what, error)
        assert isinstance(found, REFUSALS), (what, error)
        assert "private" in what or found.__cause__ is error


@pytest.mark.parametrize("what", CALLS)
def test_too_little_memory_never_means_that_bytes_are_not_valid(raising, what):
    found = raising(what, MemoryError())
    assert isinstance(found, PqsecError)
    assert not isinstance(found, REFUSALS)
    assert "memory" in str(found)


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("what", CALLS)
def test_the_end_of_the_process_passes(raising, what, end):
    assert isinstance(raising(what, end()), end)


def test_a_private_key_is_not_in_the_error_of_the_library(raising):
    found = raising("a private key", ValueError("secret"))
    assert found.__cause__ is None
    assert found.__context__ is None
    assert "secret" not in str(found)


def test_a_certificate_with_a_tls_feature_that_the_library_does_not_know():
    """KeyError, from an unauthenticated peer's certificate too."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "/talker")])
    oid = x509.ObjectIdentifier("1.3.6.1.5.5.7.1.24")
    feature = x509.UnrecognizedExtension(oid, bytes.fromhex("3003020104"))
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), 5, NOW, NOW + timedelta(9))
        .add_extension(feature, critical=False)
        .sign(key, hashes.SHA256())
    )
    with pytest.raises(MalformedError, match="not a certificate"):
        Certificate.from_der(made.public_bytes(Encoding.DER))
