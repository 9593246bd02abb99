"""OpenSSL takes the documents and certificates we make, and refuses what was tampered with.

The system's OpenSSL stands for the DDS stacks linked with it (3.0 on Debian 12); 3.5 is
the first that knows ML-DSA.
"""

import pytest

from pqsec_pki.smime import document_in
from tests.interop.conftest import ML_DSA_ONLY, STOCK
from tests.interop.der import Der

pytestmark = pytest.mark.interop

each_openssl = pytest.mark.parametrize("any_openssl", ["system", "3.5"], indirect=True)
each_document = pytest.mark.parametrize("file", ["governance.p7s", "permissions.p7s"])

STACKS_FLAGS = ("smime", "-verify", "-text", "-noverify", "-nointern")
"""What DDS stacks do with a document: PKCS7_verify with these flags and the pinned CA."""


def altered(signed):
    """`signed` with its document saying something else."""
    changed = signed.replace(b"<max>10</max>", b"<max>99</max>", 1)
    assert changed != signed
    return changed


def lines(text):
    return text.replace(b"\r\n", b"\n")


@each_openssl
@each_document
@pytest.mark.parametrize("profile", STOCK)
def test_a_document_for_stock_stacks_verifies_as_they_verify_it(labs, any_openssl, profile, file):
    folder = labs(profile).alice
    ca, signed = folder / "permissions_ca.cert.pem", folder / file
    read = any_openssl(*STACKS_FLAGS, "-certfile", ca, "-in", signed)
    assert lines(read) == lines(document_in(signed.read_bytes()))


@each_openssl
@each_document
@pytest.mark.parametrize("profile", STOCK)
def test_its_signer_verifies_too_as_older_stacks_ask(labs, any_openssl, profile, file):
    # Cyclone DDS 0.10 and Fast DDS 2.9: the chain, and the certificate's S/MIME purpose
    folder = labs(profile).alice
    ca = folder / "permissions_ca.cert.pem"
    any_openssl("smime", "-verify", "-text", "-CAfile", ca, "-in", folder / file)


@each_openssl
@each_document
@pytest.mark.parametrize("profile", STOCK)
def test_an_altered_document_is_refused(labs, any_openssl, put, profile, file):
    folder = labs(profile).alice
    bad = put("altered.p7s", altered((folder / file).read_bytes()))
    ca = folder / "permissions_ca.cert.pem"
    words = any_openssl.refuses(*STACKS_FLAGS, "-certfile", ca, "-in", bad)
    assert "digest failure" in words


@each_openssl
@pytest.mark.parametrize("profile", STOCK)
def test_a_document_of_another_ca_is_refused(labs, other_labs, any_openssl, profile):
    ca = labs(profile).alice / "permissions_ca.cert.pem"
    theirs = other_labs(profile).alice / "governance.p7s"
    words = any_openssl.refuses(*STACKS_FLAGS, "-certfile", ca, "-in", theirs)
    assert "signer certificate not found" in words


@each_document
@pytest.mark.parametrize("profile", [*STOCK, *ML_DSA_ONLY])
def test_cms_verify_takes_a_document(labs, openssl35, profile, file):
    folder = labs(profile).alice
    ca, signed = folder / "permissions_ca.cert.pem", folder / file
    read = openssl35("cms", "-verify", "-text", "-in", signed, "-certfile", ca, "-CAfile", ca)
    assert lines(read) == lines(document_in(signed.read_bytes()))


@each_document
@pytest.mark.parametrize("profile", ML_DSA_ONLY)
def test_cms_verify_refuses_an_altered_post_quantum_document(labs, openssl35, put, profile, file):
    folder = labs(profile).alice
    bad = put("altered.p7s", altered((folder / file).read_bytes()))
    ca = folder / "permissions_ca.cert.pem"
    words = openssl35.refuses("cms", "-verify", "-text", "-in", bad, "-certfile", ca, "-CAfile", ca)
    assert "verification failure" in words


@pytest.mark.parametrize("profile", ML_DSA_ONLY)
def test_cms_verify_refuses_a_post_quantum_document_of_another_ca(
    labs, other_labs, openssl35, profile
):
    ca = labs(profile).alice / "permissions_ca.cert.pem"
    theirs = other_labs(profile).alice / "governance.p7s"
    openssl35.refuses("cms", "-verify", "-text", "-in", theirs, "-certfile", ca, "-CAfile", ca)


@each_openssl
@pytest.mark.parametrize("profile", ML_DSA_ONLY)
def test_a_post_quantum_document_fails_as_the_stacks_verify_it_as_documented(
    labs, any_openssl, profile
):
    folder = labs(profile).alice
    ca = folder / "permissions_ca.cert.pem"
    any_openssl.refuses(*STACKS_FLAGS, "-certfile", ca, "-in", folder / "governance.p7s")


def strict(folder):
    ca = folder / "identity_ca.cert.pem"
    return "verify", "-x509_strict", "-check_ss_sig", "-CAfile", ca, folder / "cert.pem"


@each_openssl
@pytest.mark.parametrize("profile", STOCK)
def test_a_chain_verifies_strictly(labs, any_openssl, profile):
    any_openssl(*strict(labs(profile).alice))


@pytest.mark.parametrize("profile", ML_DSA_ONLY)
def test_a_post_quantum_chain_verifies_strictly(labs, openssl35, profile):
    openssl35(*strict(labs(profile).alice))


@pytest.mark.parametrize("profile", [*STOCK, *ML_DSA_ONLY])
def test_a_certificate_of_a_ca_with_the_same_name_is_refused(
    labs, other_labs, openssl35, enclave, profile
):
    theirs = (other_labs(profile).alice / "cert.pem").read_bytes()
    words = openssl35.refuses(*strict(enclave(labs(profile).alice, {"cert.pem": theirs})))
    assert "unable to get local issuer certificate" in words


@pytest.mark.parametrize("profile", [*STOCK, *ML_DSA_ONLY])
def test_a_certificate_with_a_changed_name_is_refused(labs, openssl35, put, profile):
    folder = labs(profile).alice
    der = openssl35("x509", "-in", folder / "cert.pem", "-outform", "DER")
    changed = put("changed.der", der.replace(b"/lab/alice", b"/lab/admin"))
    ca = folder / "identity_ca.cert.pem"
    words = openssl35.refuses("verify", "-CAfile", ca, changed)
    assert "certificate signature failure" in words


@each_openssl
@pytest.mark.parametrize("profile", STOCK)
def test_the_private_key_belongs_to_the_certificate(labs, any_openssl, profile):
    folder = labs(profile).alice
    of_key = any_openssl("pkey", "-in", folder / "key.pem", "-pubout")
    of_certificate = any_openssl("x509", "-in", folder / "cert.pem", "-noout", "-pubkey")
    assert of_key == of_certificate


# OpenSSL passes over alternative signatures and countersignatures. What they cover is put
# together here from the standards, without this project's code; OpenSSL checks the ML-DSA.


def ml_dsa_holds(openssl35, put, spki, signature, covered):
    def arguments(data, suffix):
        files = put(f"key{suffix}", spki), put(f"sig{suffix}", signature), put(f"in{suffix}", data)
        key, sig, text = files
        return "pkeyutl", "-verify", "-rawin", "-pubin", "-inkey", key, "-sigfile", sig, "-in", text

    openssl35.refuses(*arguments(covered + b"!", ".changed"))
    openssl35(*arguments(covered, ""))


EXTENSIONS, ALT_KEY, ALT_VALUE = 0xA3, bytes.fromhex("0603551d48"), bytes.fromhex("0603551d4a")


def extensions_of(tbs):
    """The certificate's extensions by DER OID."""
    [listed] = next(part for part in tbs.parts if part.tag == EXTENSIONS).parts
    return {bytes(each.parts[0]): each for each in listed.parts}


def covered_by_alternative_signature(tbs):
    """ITU-T X.509 (10/2019) 9.8: all but the field signature and extension altSignatureValue."""
    version, serial, _signature, *rest, _extensions = tbs.parts
    kept = b"".join(each for oid, each in extensions_of(tbs).items() if oid != ALT_VALUE)
    extensions = Der.of(EXTENSIONS, Der.of(0x30, kept))
    return Der.of(0x30, b"".join([version, serial, *rest, extensions]))


@pytest.mark.parametrize("who", ["identity_ca.cert.pem", "cert.pem"])
def test_the_alternative_signature_holds(labs, openssl35, put, who):
    folder = labs("transition").alice
    tbs, ca_tbs = (
        Der(openssl35("x509", "-in", folder / name, "-outform", "DER")).parts[0]
        for name in (who, "identity_ca.cert.pem")
    )
    alternative_key = extensions_of(ca_tbs)[ALT_KEY].parts[-1].content
    value = Der(extensions_of(tbs)[ALT_VALUE].parts[-1].content)
    covered = covered_by_alternative_signature(tbs)
    ml_dsa_holds(openssl35, put, alternative_key, value.content[1:], covered)


COUNTERSIGNATURE = bytes.fromhex("06092a864886f70d010906")


@each_document
def test_the_countersignature_holds(labs, openssl35, put, file):
    lab = labs("transition")
    cms = openssl35("cms", "-cmsout", "-in", lab.alice / file, "-outform", "DER")
    signed_data = Der(cms).parts[1].parts[0]
    [signer_info] = signed_data.parts[-1].parts
    *_, signature, unsigned = signer_info.parts
    [countersignature] = unsigned.parts
    assert countersignature.parts[0] == COUNTERSIGNATURE
    [counter] = countersignature.parts[1].parts
    _version, _sid, _digest, attributes, _algorithm, counter_signature = counter.parts
    # RFC 5652 11.4: its attributes hold the digest of the signature that it signs
    digest = openssl35("dgst", "-sha512", "-binary", put("signature", signature.content))
    assert Der.of(0x04, digest) in attributes
    # 5.4: signed as a SET OF, whatever tag they stand under
    covered = Der.of(0x31, attributes.content)
    spki = lab.authorities.countersigner.key.public_key.spki
    ml_dsa_holds(openssl35, put, spki, counter_signature.content, covered)


@pytest.mark.parametrize("profile", ML_DSA_ONLY)
def test_openssl_names_the_algorithm_of_a_post_quantum_certificate(labs, openssl35, profile):
    text = openssl35("x509", "-in", labs(profile).alice / "cert.pem", "-noout", "-text").decode()
    name = labs(profile).keystore.profile.identity_key.wire_name
    assert text.count(f"Signature Algorithm: {name}") == 2
    assert f"Public Key Algorithm: {name}" in text
