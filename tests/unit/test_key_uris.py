"""URIs of keys in tokens, and the files that refer to them."""

import base64
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki._asn1 import KeyReference, encode, raw
from pqsec_pki.algorithms import SIGNATURES, pem
from pqsec_pki.enrolment import Bundle
from pqsec_pki.errors import MalformedError, UsageError
from pqsec_pki.tokens import KeyUri, is_reference, made_keys, reference_to, uri_in
from tests.unit.keystores import NOW, made

LAB = "pkcs11:token=lab;object=identity-ca"


def test_a_uri_in_any_order_and_case_has_one_form():
    for text in (LAB, "PKCS11:object=identity-ca;token=lab;type=private", f"{LAB};type=private"):
        assert str(KeyUri.parse(text)) == f"{LAB};type=private"


def test_one_key_is_not_named_for_two_cas():
    """It is refused before a token is used: two keys with one label would be made there."""
    row = SIGNATURES.named("ecdsa-p256")
    for second in (LAB, "PKCS11:object=identity-ca;token=lab"):
        wanted = {"identity_ca": (LAB, row), "permissions_ca": (second, row)}
        with pytest.raises(UsageError, match="one key is named twice"), made_keys(wanted):
            pass


def test_escapes_are_read_and_written():
    found = KeyUri.parse("pkcs11:token=my%20lab;id=%01%ff;object=a%3Bb")
    assert (found.token, found.object, found.id) == ("my lab", "a;b", b"\x01\xff")
    assert str(found) == "pkcs11:token=my%20lab;object=a%3Bb;id=%01%FF;type=private"


@pytest.mark.parametrize("form", ["file:/run/pin", "/run/pin", "file:///run/pin"])
def test_a_pin_source_is_a_file(form):
    found = KeyUri.parse(f"{LAB}?pin-source={form}")
    assert str(found.pin_source) == "/run/pin"
    assert str(found) == f"{LAB};type=private?pin-source=file:/run/pin"


text = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=20)


@given(token=text, label=text, identifier=st.none() | st.binary(min_size=1, max_size=8))
def test_what_is_written_is_read_back(token, label, identifier):
    uri = KeyUri(token=token, object=label, id=identifier)
    assert KeyUri.parse(str(uri)) == uri


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("lab", "not a URI of a key"),
        ("pkcs11", "not a URI of a key"),
        ("pkcs11:", "names no token"),
        ("pkcs11:object=x", "names no token"),
        ("pkcs11:token=lab", "no key in it"),
        ("pkcs11:token=lab;token=lab;object=x", "'token' twice"),
        ("pkcs11:token=lab;object=x;colour=red", "is not known: colour"),
        ("pkcs11:token=lab;object=x;type=public", "no private key"),
        ("pkcs11:token=lab;object", "no valid value"),
        ("pkcs11:token=lab;object=%zz", "no valid value"),
        ("pkcs11:token=lab;object=ü", "no valid value"),
        ("pkcs11:token=lab;object=%ff", "not UTF-8"),
        ("pkcs11:token=lab;object=%1b[2J", "unprintable"),
        (f"{LAB}?pin-value=1234", "the URI of a key contains a PIN"),
        (f"{LAB}?module-path=/tmp/evil.so", "names the library"),
        (f"{LAB}?module-name=evil", "names the library"),
        (f"{LAB}?pin-source=%7Ccat%20/etc/pin", "not a file's absolute path"),
        (f"{LAB}?pin-source=pin", "not a file's absolute path"),
        (f"{LAB}?colour=red", "is not known: colour"),
        (f"{LAB};id={'%00' * 1000}", "at most"),
    ],
)
def test_a_uri_that_is_not_one_is_refused(uri, words):
    with pytest.raises(UsageError, match=words):
        KeyUri.parse(uri)


@pytest.mark.parametrize("uri", [f"{LAB};type=private", "cloudkms:projects/p/keys/k"])
def test_a_file_refers_to_a_key(uri):
    data = reference_to(uri)
    assert is_reference(data)
    assert uri_in(data) == uri


def test_the_form_is_that_of_the_openssl_provider():
    """As its tool uri2pem writes it for this URI."""
    data = reference_to("pkcs11:token=t;object=o;type=private")
    [line] = data.decode().splitlines()[1:-1][:1]
    assert data.startswith(b"-----BEGIN PKCS#11 PROVIDER URI-----\n")
    assert base64.b64decode(line)[:29] == b"\x30\x41" + b"\x1a\x19PKCS#11 Provider URI v1.0"


def damaged():
    whole = reference_to(LAB)
    yield b""
    yield whole + whole
    yield whole + b"x"
    yield whole.replace(b"END PKCS", b"END PKDS")
    yield whole[:-10]
    yield whole.replace(b"\nM", b"\n=")
    description = raw(encode("other"))
    yield pem("PQSEC KEY URI", encode(KeyReference(description=description, uri=LAB)))[:-5]


@pytest.mark.parametrize("data", list(damaged()))
def test_a_damaged_reference_is_refused(data):
    with pytest.raises(MalformedError):
        uri_in(data)


@given(st.binary(max_size=300))
def test_no_bytes_end_the_reader_otherwise(data):
    begin, end = reference_to(LAB).splitlines()[:: len(reference_to(LAB).splitlines()) - 1]
    for each in (data, b"\n".join((begin, base64.b64encode(data), end, b""))):
        with suppress(MalformedError):
            uri_in(each)


def test_a_damaged_reference_in_a_keystore_is_named(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    path = keystore.root / "private/identity_ca.key.pem"
    path.write_bytes(reference_to(LAB)[:-5])
    with pytest.raises(MalformedError) as refused:
        keystore.key_uris()
    assert refused.value.where == str(path)


def test_a_bundle_never_says_where_a_key_is(tmp_path):
    """Who changes a bundle could have the robot give a PIN to a token of his choice."""
    keystore = made(tmp_path / "k", "classical")
    (keystore.root / "enclaves/talker/key.pem").write_bytes(reference_to(LAB))
    bundle = Bundle.of(keystore, ["/talker"], now=NOW)
    assert not bundle.has_keys
    for file in ("key.pem", "alt.key.pem"):
        changed = {"/talker": {**bundle.enclaves["/talker"], file: reference_to(LAB)}}
        with pytest.raises(MalformedError, match="must not say where a key is"):
            Bundle.from_bytes(replace(bundle, enclaves=changed).to_bytes())


def test_a_bundle_for_a_key_in_a_token_and_one_in_a_file_is_refused(tmp_path):
    keystore = made(tmp_path / "k", "transition")
    (keystore.root / "enclaves/talker/key.pem").write_bytes(reference_to(LAB))
    with pytest.raises(UsageError, match="one key in a token and one in a file"):
        Bundle.of(keystore, ["/talker"], now=NOW)
