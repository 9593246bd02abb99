"""We read what OpenSSL writes: keys in its forms, its certificates, its signed documents.

And it reads our keys, plain and encrypted.
"""

from datetime import timedelta
from functools import cache

import pytest

from pqsec_pki.algorithms import (
    SIGNATURES,
    Family,
    load_private_key,
    load_public_key,
    private_key_pem,
)
from pqsec_pki.certificates import Certificate, verify_authority, verify_chain
from pqsec_pki.errors import MalformedError, PassphraseError, VerificationError
from pqsec_pki.smime import Require, verify
from tests.interop.conftest import permissions_of

pytestmark = pytest.mark.interop

PASSPHRASE = "corréct horse"
CLASSICAL = [row.name for row in SIGNATURES if row.family is Family.CLASSICAL]
ML_DSA = [row.name for row in SIGNATURES if row.family is Family.PQ]

GENERATE = {
    "ecdsa-p256": ("EC", "-pkeyopt", "ec_paramgen_curve:P-256"),
    "ecdsa-p384": ("EC", "-pkeyopt", "ec_paramgen_curve:P-384"),
    "rsa-2048": ("RSA", "-pkeyopt", "rsa_keygen_bits:2048"),
    "rsa-3072": ("RSA", "-pkeyopt", "rsa_keygen_bits:3072"),
    "rsa-4096": ("RSA", "-pkeyopt", "rsa_keygen_bits:4096"),
    "ml-dsa-44": ("ML-DSA-44",),
    "ml-dsa-65": ("ML-DSA-65",),
    "ml-dsa-87": ("ML-DSA-87",),
}
"""Words for `openssl genpkey -algorithm`."""

fresh_key = cache(lambda name: SIGNATURES.named(name).generate())


@pytest.fixture
def openssl_for(request):
    """openssl_for(row name) is the oldest OpenSSL here that knows the algorithm."""

    def choose(name):
        return request.getfixturevalue("openssl" if name in CLASSICAL else "openssl35")

    return choose


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("name", CLASSICAL + ML_DSA)
def test_openssl_reads_our_keys(openssl_for, put, name):
    openssl, key = openssl_for(name), fresh_key(name)
    plain = put("plain.pem", private_key_pem(key))
    encrypted = put("encrypted.pem", private_key_pem(key, PASSPHRASE.encode()))
    public = ("pkey", "-pubout", "-outform", "DER", "-in")
    assert openssl(*public, plain) == key.public_key.spki
    assert openssl(*public, encrypted, "-passin", f"pass:{PASSPHRASE}") == key.public_key.spki
    openssl.refuses(*public, encrypted, "-passin", "pass:wrong")


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("name", CLASSICAL + ML_DSA)
def test_we_read_openssl_keys(openssl_for, put, name):
    openssl = openssl_for(name)
    made = openssl("genpkey", "-algorithm", *GENERATE[name])
    spki = openssl("pkey", "-in", put("key.pem", made), "-pubout", "-outform", "DER")

    key = load_private_key(made)
    assert key.algorithm.name == name
    assert key.public_key.spki == spki
    load_public_key(spki).verify(key.sign(b"text"), b"text")
    der = openssl("pkcs8", "-topk8", "-nocrypt", "-in", put("key.pem", made), "-outform", "DER")
    assert load_private_key(der).public_key.spki == spki


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("name", CLASSICAL + ML_DSA)
def test_we_read_keys_that_openssl_encrypted(openssl_for, put, name):
    openssl = openssl_for(name)
    generate = ("genpkey", "-algorithm", *GENERATE[name])
    made = openssl(*generate, "-aes-256-cbc", "-pass", f"pass:{PASSPHRASE}")
    assert b"ENCRYPTED PRIVATE KEY" in made
    spki = openssl(
        *("pkey", "-in", put("key.pem", made), "-passin", f"pass:{PASSPHRASE}"),
        *("-pubout", "-outform", "DER"),
    )
    assert load_private_key(made, PASSPHRASE.encode()).public_key.spki == spki
    with pytest.raises(PassphraseError):
        load_private_key(made, b"wrong")
    with pytest.raises(PassphraseError):
        load_private_key(made)


@pytest.mark.parametrize("encrypt", [(), ("-aes-256-cbc", "-passout", f"pass:{PASSPHRASE}")])
@pytest.mark.parametrize("name", ["ecdsa-p256", "rsa-2048"])
def test_we_read_keys_in_openssl_own_old_form(openssl, put, name, encrypt):
    made = put("key.pem", openssl("genpkey", "-algorithm", *GENERATE[name]))
    old = openssl("pkey", "-in", made, "-traditional", *encrypt)
    assert b"BEGIN PRIVATE KEY" not in old
    passphrase = PASSPHRASE.encode() if encrypt else None
    spki = openssl("pkey", "-in", made, "-pubout", "-outform", "DER")
    assert load_private_key(old, passphrase).public_key.spki == spki


def in_form(openssl, name, form):
    option = f"ml-dsa.output_formats={form}"
    return openssl("genpkey", "-algorithm", *GENERATE[name], "-provparam", option)


@pytest.mark.parametrize("form", ["seed-priv", "seed-only", "bare-seed"])
@pytest.mark.parametrize("name", ML_DSA)
def test_we_read_each_form_of_a_post_quantum_key_that_has_the_seed(openssl35, put, name, form):
    made = in_form(openssl35, name, form)
    spki = openssl35("pkey", "-in", put("key.pem", made), "-pubout", "-outform", "DER")
    assert load_private_key(made).public_key.spki == spki


@pytest.mark.parametrize("form", ["priv-only", "bare-priv"])
@pytest.mark.parametrize("name", ML_DSA)
def test_a_post_quantum_key_without_its_seed_is_refused(openssl35, name, form):
    with pytest.raises(MalformedError):
        load_private_key(in_form(openssl35, name, form))


class MadeByOpenSSL:
    """A CA that OpenSSL made: files of its key and certificate, and what it signs."""

    def __init__(self, openssl, folder, name):
        self.openssl = openssl
        self.algorithm, self.folder = name, folder
        self.key, self.pem = folder / "ca.key", folder / "ca.crt"
        openssl("genpkey", "-algorithm", *GENERATE[name], "-out", self.key)
        openssl(
            *("req", "-x509", "-new", "-key", self.key, "-out", self.pem, "-days", "5"),
            *("-subj", "/O=Lab/CN=Permissions CA", "-config", "/dev/null"),
            *("-addext", "basicConstraints=critical,CA:TRUE"),
            *("-addext", "subjectKeyIdentifier=hash"),
        )
        self.certificate = Certificate.from_pem(self.pem.read_bytes())

    def sign(self, document, *options, command="cms"):
        text = self.folder / "text.xml"
        text.write_bytes(document)
        signer = ("-signer", self.pem, "-inkey", self.key)
        return self.openssl(command, "-sign", "-text", "-in", text, *signer, *options)

    def issue(self, *options, command=("x509", "-req")):
        """A participant's key and certificate."""
        key, request = self.folder / "leaf.key", self.folder / "leaf.csr"
        self.openssl("genpkey", "-algorithm", *GENERATE[self.algorithm], "-out", key)
        subject = ("-subj", "/O=Lab/CN=alice", "-config", "/dev/null")
        self.openssl("req", "-new", "-key", key, "-out", request, *subject)
        by = ("-CA", self.pem, "-CAkey", self.key, "-set_serial", "7", "-days", "3")
        return Certificate.from_pem(self.openssl(*command, "-in", request, *by, *options))


@pytest.fixture
def ca_of(openssl_for, tmp_path):
    """ca_of(row name) is a CA that OpenSSL made."""

    def make(name):
        return MadeByOpenSSL(openssl_for(name), tmp_path, name)

    return make


@pytest.fixture
def document(now):
    return permissions_of("/lab/alice", now)


def lines(text):
    return text.replace(b"\r\n", b"\n")


def check(made, signed, document, require):
    """We take `signed`, and neither a changed copy nor a promise it does not keep."""
    assert lines(verify(signed, made.certificate, require=require).document) == lines(document)
    with pytest.raises(VerificationError, match="changed after signing"):
        verify(signed.replace(b"rt/chatter", b"rt/shouter"), made.certificate)
    with pytest.raises(VerificationError, match="required"):
        verify(signed, made.certificate, require=Require.BOTH)


@pytest.mark.slow(but=3)
@pytest.mark.parametrize(
    "options",
    [
        (),
        ("-md", "sha384"),
        ("-md", "sha512"),
        ("-nocerts",),
        ("-nosmimecap",),
        ("-crlfeol",),
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("command", ["smime", "cms"])
@pytest.mark.parametrize("name", ["ecdsa-p256", "rsa-2048"])
def test_we_verify_documents_that_openssl_signed(ca_of, document, name, command, options):
    made = ca_of(name)
    check(made, made.sign(document, *options, command=command), document, Require.CLASSICAL)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", ["ecdsa-p384", "rsa-3072"])
def test_we_verify_documents_signed_with_larger_keys(ca_of, document, name):
    made = ca_of(name)
    check(made, made.sign(document, command="smime"), document, Require.CLASSICAL)


@pytest.mark.parametrize(
    "options",
    [
        ("-md", "sha512"),
        ("-md", "sha3-512"),
        ("-md", "shake256"),
        ("-md", "sha512", "-keyid"),
        ("-md", "sha512", "-nocerts"),
        ("-md", "sha512", "-nosmimecap"),
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("name", ML_DSA)
def test_we_verify_documents_that_openssl_signed_with_ml_dsa(ca_of, document, name, options):
    made = ca_of(name)
    check(made, made.sign(document, *options), document, Require.PQ)


def test_a_digest_weaker_than_the_key_is_refused(ca_of, document):
    made = ca_of("ml-dsa-87")
    with pytest.raises(VerificationError, match="too weak"):
        verify(made.sign(document, "-md", "sha256"), made.certificate)


def test_a_document_signed_without_text_is_refused_with_the_way_out(ca_of, document, tmp_path):
    made = ca_of("ecdsa-p256")
    text = tmp_path / "plain.xml"
    text.write_bytes(document)
    sign = ("smime", "-sign", "-in", text, "-signer", made.pem, "-inkey", made.key)
    with pytest.raises(VerificationError) as refusal:
        verify(made.openssl(*sign), made.certificate)
    assert "-text" in str(refusal.value.hint)


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("name", CLASSICAL + ML_DSA)
def test_we_verify_chains_that_openssl_made(ca_of, tmp_path, now, name):
    made, soon = ca_of(name), now + timedelta(hours=1)
    extensions = tmp_path / "leaf.cnf"
    extensions.write_text("basicConstraints=critical,CA:FALSE\nkeyUsage=digitalSignature\n")
    verify_authority(made.certificate, now=soon)
    leaf = made.issue("-extfile", extensions)
    verify_chain(leaf, made.certificate, now=soon)
    with pytest.raises(VerificationError, match="expired"):
        verify_chain(leaf, made.certificate, now=now + timedelta(days=4))


def test_we_verify_the_version_1_certificates_of_the_tutorials(ca_of, now):
    made = ca_of("ecdsa-p256")
    leaf = made.issue()
    if leaf.version == 3:  # newer OpenSSL makes version 1 of these commands only if it is told to
        leaf = made.issue("-config", "/dev/null", command=("req", "-x509", "-x509v1"))
    assert leaf.version == 1
    verify_chain(leaf, made.certificate, now=now + timedelta(hours=1))
