"""Nothing but PqsecError comes out, whatever goes in, and no message tells of a key."""

import base64
import json
import traceback
from datetime import UTC, datetime, timedelta

import pytest
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
)
from cryptography.utils import CryptographyDeprecationWarning
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pqsec_pki.algorithms import (
    SIGNATURES,
    exact_der,
    is_encrypted,
    load_private_key,
    load_public_key,
    pem,
    private_key_pem,
    profile_named,
    unpem,
)
from pqsec_pki.certificates import Authority, Certificate, verify_authority, verify_chain
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore
from pqsec_pki.smime import Require, Signer, document_in, is_signed, sign, verify
from tests.longer import examples
from tests.some_keys import some_key

NOW = datetime(2026, 11, 21, tzinfo=UTC)
YEAR = timedelta(days=365)
PASSPHRASE = b"horse"

hostile = settings(max_examples=examples(250), suppress_health_check=list(HealthCheck))
# cryptography warns of what it will refuse some day (NULL parameters, odd names).
pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
assert issubclass(CryptographyDeprecationWarning, UserWarning)


def key_of(name):
    return SIGNATURES.named(name).generate()


def authority_of(main, alternative=None, owner="CA"):
    second = key_of(alternative) if alternative else None
    return Authority.self_signed("CA", some_key(main, owner), second, now=NOW, validity=10 * YEAR)


# Seeds


CAS = [
    authority_of("p256", "ml-dsa-44"),
    authority_of("mldsa44+p256"),
    authority_of("ml-dsa-44"),
    authority_of("rsa-2048"),
    authority_of("mldsa65+rsa3072"),
]
SECOND = key_of("ml-dsa-44").public_key
LEAVES = [
    ca.issue("/a", ca.key.public_key, alternative=SECOND, now=NOW, validity=YEAR) for ca in CAS
]
KEYS = [ca.key for ca in CAS] + [key_of("p384"), key_of("mldsa44+ed25519")]
COUNTER = authority_of("ml-dsa-44", owner="who countersigns")
MESSAGES = [
    sign(
        b"<dds>\n</dds>\n",
        Signer(ca.certificate, ca.key),
        countersigner=Signer(COUNTER.certificate, COUNTER.key),
        embed_certificate=False,
        now=NOW,
    )
    for ca in CAS[:4]
]


def quick(key):
    """`key` encrypted with few iterations, as many loads are made of it."""
    handle = key.handle
    secret = BestAvailableEncryption(PASSPHRASE)
    forms = [handle.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, secret)]
    if not key.algorithm.name.startswith("ml-dsa"):
        old = PrivateFormat.TraditionalOpenSSL
        forms += [
            handle.private_bytes(Encoding.PEM, old, each) for each in (secret, NoEncryption())
        ]
    return forms


PLAIN_KEYS = [form for key in KEYS for form in (key.pkcs8, private_key_pem(key))]
ENCRYPTED_KEYS = [form for key in (KEYS[0], KEYS[2], KEYS[3]) for form in quick(key)]


# Mutations


@st.composite
def mutated(draw, seeds):
    """One of `seeds` with a few changes: flips, cuts, insertions, repetitions."""
    data = bytearray(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        size = draw(st.integers(1, 40))
        match draw(st.sampled_from(["flip", "set", "insert", "delete", "cut", "repeat"])):
            case "flip" if data:
                data[at] ^= 1 << draw(st.integers(0, 7))
            case "set" if data:
                data[at] = draw(st.sampled_from([0, 1, 2, 4, 5, 6, 0x30, 0x31, 0x7F, 0x80, 0xFF]))
            case "insert":
                data[at:at] = draw(st.binary(min_size=1, max_size=8))
            case "delete":
                del data[at : at + size]
            case "cut":
                del data[at:]
            case _:
                data[at:at] = data[at : at + size]
    return bytes(data)


def only_ours(action):
    """What `action` gives; None if it raised one of our errors."""
    try:
        return action()
    except PqsecError:
        return None


def look_over(certificate):
    """Use everything that a certificate offers: nothing may fail later."""
    repr(certificate)
    for name in ("subject_name", "subject_text", "fingerprint", "is_self_issued", "pem"):
        getattr(certificate, name)
    assert certificate.subject_key_identifier is None or certificate.subject_key_identifier
    assert certificate.signature_algorithm
    for action in (
        lambda: certificate.public_key,
        lambda: certificate.alternative_key,
        lambda: certificate.handshake_keys,
        lambda: verify_authority(certificate, now=NOW),
    ):
        only_ours(action)
    for ca in CAS[:2]:
        for required in (True, False):
            only_ours(
                lambda ca=ca, required=required: verify_chain(
                    certificate, ca.certificate, now=NOW, require_alternative=required
                )
            )
            only_ours(
                lambda required=required: verify_chain(
                    LEAVES[0], certificate, now=NOW, require_alternative=required
                )
            )


def read_certificate(data):
    for read in (Certificate.from_der, Certificate.from_pem):
        certificate = only_ours(lambda read=read: read(data))
        if certificate is not None:
            look_over(certificate)


@hostile
@given(st.binary(max_size=200))
@example(b"\x30" * 100_000)
@example(b"\x30\x80" * 100_000)
@example(b"-----BEGIN CERTIFICATE-----\n" * 9000)
def test_any_bytes_as_a_certificate(data):
    read_certificate(data)


@hostile
@given(st.binary(max_size=200))
def test_any_bytes_in_pem_as_a_certificate(data):
    read_certificate(pem("CERTIFICATE", data))


@hostile
@given(mutated([each.der for each in (*LEAVES, *(ca.certificate for ca in CAS))]))
def test_a_mutated_certificate(data):
    read_certificate(data)
    read_certificate(pem("CERTIFICATE", data))


@hostile
@given(mutated([each.pem for each in LEAVES]))
def test_a_mutated_certificate_in_pem(data):
    read_certificate(data)


def small(certificate):
    """The certificate's first bytes, where names, times and extensions are."""
    return st.integers(0, min(len(certificate.der), 300) - 1)


@hostile
@given(st.data())
def test_a_certificate_with_one_byte_of_its_head_changed(data):
    certificate = data.draw(st.sampled_from([CAS[3].certificate, LEAVES[3]]))
    der = bytearray(certificate.der)
    der[data.draw(small(certificate))] = data.draw(st.integers(0, 255))
    read_certificate(bytes(der))


TIMES = st.sampled_from(
    [b"000000000000Z", b"00000101000000Z", b"99991231235959Z", b"991332996199Z", b"-1-1-1-1-1-1-Z"]
) | st.text("0123456789Z+-.", min_size=10, max_size=20).map(str.encode)


@hostile
@given(TIMES, st.sampled_from([0x17, 0x18]))
def test_a_certificate_with_any_time(time, tag):
    der, old = CAS[0].certificate.der, b"\x17\x0d261120000000Z"
    assert old in der
    new = bytes([tag, len(time)]) + time
    assert len(new) < 128
    read_certificate(_replaced(der, old, new))


def _replaced(der, old, new):
    """`der` with other bytes inside, and the lengths around them put right."""
    if old not in der:
        return der
    tag, size, head = der[0], der[1], 2
    if size & 0x80:
        head += size & 0x7F
        size = int.from_bytes(der[2:head])
    body, rest = der[head : head + size], der[head + size :]
    if der.startswith(old):
        return new + der[len(old) :]
    if old in body and tag & 0x20:
        body = _replaced(body, old, new)
    size = len(body)
    length = bytes([size]) if size < 0x80 else b"\x82" + size.to_bytes(2)
    if 0x80 <= size < 0x100:
        length = bytes([0x81, size])
    return bytes([tag]) + length + body + _replaced(rest, old, new)


def test_a_time_can_be_replaced():
    der, old = CAS[0].certificate.der, b"\x17\x0d261120000000Z"
    assert Certificate.from_der(_replaced(der, old, b"\x17\x0d261119000000Z")).not_before < NOW
    later = Certificate.from_der(_replaced(der, old, b"\x18\x0f20501120000000Z"))
    assert later.not_before.year == 2050


# Public keys


@hostile
@given(st.binary(max_size=100))
def test_any_bytes_as_a_public_key(data):
    only_ours(lambda: load_public_key(data))


@hostile
@given(mutated([key.public_key.spki for key in KEYS]))
def test_a_mutated_public_key(data):
    key = only_ours(lambda: load_public_key(data))
    if key is not None:
        only_ours(lambda: key.verify(b"signature", b"data"))
        only_ours(lambda: key.verify_handshake(b"signature", b"data"))


@hostile
@given(st.sampled_from(KEYS), st.binary(max_size=80), st.binary(max_size=30))
def test_any_bytes_as_a_signature(key, signature, identifier):
    for action in (
        lambda: key.public_key.verify(signature, b"data"),
        lambda: key.public_key.verify(signature, b"data", identifier),
        lambda: key.public_key.verify_handshake(signature, b"data"),
    ):
        with pytest.raises(PqsecError):
            action()


# Private keys


WINDOW = 8


def secrets_of(key):
    """The bytes that nobody may see, or the first of them; the rest is known to all."""
    for handle in key.handle if isinstance(key.handle, tuple) else [key.handle]:
        numbers = getattr(handle, "private_numbers", None)
        if numbers is None:
            yield handle.private_bytes_raw()
            continue
        for name in ("private_value", "d", "p", "q"):
            number = getattr(numbers(), name, 0)
            yield number.to_bytes((number.bit_length() + 7) // 8)[:32]


def needles_of(key):
    """Every run of 8 bytes of a private key, as it could stand in a text."""
    for secret in secrets_of(key):
        for start in range(len(secret) - WINDOW + 1):
            run = secret[start : start + WINDOW]
            yield from (run.hex(), run.hex(" "), run.hex(":"), repr(run)[2:-1])
            yield run.decode("latin-1")
            yield str(int.from_bytes(run, "big"))
            yield str(list(run))[1:-1]
        for start in range(3):
            text = base64.b64encode(secret[start:]).decode()
            yield from (text[at : at + 10] for at in range(len(text) - 12))


NEEDLES = sorted({needle for key in KEYS for needle in needles_of(key)})


def tells_nothing(text):
    found = [needle for needle in NEEDLES if needle in text]
    assert not found


def load_and_listen(data, passphrase):
    """Load a key; whatever is said of it must not tell what it is."""
    is_encrypted(data)
    try:
        key = load_private_key(data, passphrase)
    except PqsecError as error:
        told = [str(error), repr(error), str(error.hint), *traceback.format_exception(error)]
        tells_nothing("\n".join(told))
        tells_nothing(repr(error.__context__) + repr(error.__cause__))
    else:
        tells_nothing(f"{key!r} {key}")
        key.public_key.verify(key.sign(b"data"), b"data")


def test_what_would_tell_of_a_key_is_heard():
    for key in KEYS:
        for told in (key.raw.hex(), repr(key.raw), private_key_pem(key).decode()):
            with pytest.raises(AssertionError):
                tells_nothing(f"... {told} ...")


@hostile
@given(st.binary(max_size=200))
@example(b"\x30" * 100_000)
@example(b"-----BEGIN PRIVATE KEY-----\n" * 9000)
@example(b"-----BEGIN ENCRYPTED PRIVATE KEY-----\n" + b"M" * 100_000)
@example(pem("PRIVATE KEY", b"\x30\x80" * 50_000))
def test_any_bytes_as_a_private_key(data):
    for passphrase in (None, PASSPHRASE):
        load_and_listen(data, passphrase)
        load_and_listen(pem("PRIVATE KEY", data), passphrase)
        load_and_listen(pem("EC PRIVATE KEY", data), passphrase)
        load_and_listen(pem("ENCRYPTED PRIVATE KEY", data), passphrase)


@hostile
@given(mutated(PLAIN_KEYS))
def test_a_mutated_private_key(data):
    load_and_listen(data, None)


@hostile
@given(mutated([key.pkcs8 for key in KEYS]))
def test_a_mutated_private_key_in_pem(data):
    load_and_listen(pem("PRIVATE KEY", data), None)


@hostile
@given(mutated(ENCRYPTED_KEYS), st.sampled_from([None, PASSPHRASE, b"wrong"]))
def test_a_mutated_encrypted_private_key(data, passphrase):
    load_and_listen(data, passphrase)


@hostile
@given(mutated([unpem(each, "")[0][1] for each in ENCRYPTED_KEYS if b"ENCRYPTED PRIVATE" in each]))
def test_a_mutated_encrypted_private_key_in_der(data):
    load_and_listen(data, PASSPHRASE)


@hostile
@given(st.text(max_size=60) | st.binary(max_size=60).map(lambda data: data.decode("latin-1")))
def test_any_text_as_pem(text):
    only_ours(lambda: unpem(text.encode("utf-8", "surrogatepass"), "text"))


@hostile
@given(st.binary(min_size=1, max_size=200))
def test_pem_of_our_form_is_read_as_any_pem(der):
    text = pem("CERTIFICATE", der)
    assert exact_der("CERTIFICATE", text) == der
    read_as_any = unpem(text.replace(b"\n", b"\r\n"), "")
    assert unpem(text, "") == read_as_any == [("CERTIFICATE", der)]


def altered(text):
    """PEM with one character removed, replaced or inserted."""
    places = st.integers(0, len(text) - 1)
    added = st.sampled_from([b"", b"\n", b"\r\n", b" ", b"=", b"A", b"-", b"\0", b"\xff"])
    cut = st.integers(0, 1)
    return st.builds(lambda at, new, size: text[:at] + new + text[at + size :], places, added, cut)


@hostile
@given(st.binary(min_size=1, max_size=120).flatmap(lambda der: altered(pem("CERTIFICATE", der))))
@example(b"-----BEGIN CERTIFICATE-----\n-----END CERTIFICATE-----\n")
@example(b"-----BEGIN CERTIFICATE-----\nAAB=\n-----END CERTIFICATE-----\n")
def test_pem_of_another_form_is_not_read_as_ours(text):
    """Else one certificate would have several texts, and readers might differ about them."""
    der = exact_der("CERTIFICATE", text)
    assert der is None or pem("CERTIFICATE", der) == text


# Signed documents


def read_message(data):
    is_signed(data)
    only_ours(lambda: document_in(data))
    for ca in (CAS[0], COUNTER):
        verified = only_ours(
            lambda ca=ca: verify(
                data, ca.certificate, alternative_ca=COUNTER.certificate, require=Require.ANY
            )
        )
        if verified is not None:
            assert verified.document == b"<dds>\r\n</dds>\r\n"


@hostile
@given(st.binary(max_size=200))
def test_any_bytes_as_a_signed_document(data):
    read_message(data)


@hostile
@given(mutated(MESSAGES))
def test_a_mutated_signed_document(data):
    read_message(data)


def with_signature(der):
    text = base64.encodebytes(der).rstrip()
    head, _, _ = MESSAGES[0].partition(b'filename="smime.p7s"\n\n')
    boundary = MESSAGES[0].partition(b'boundary="')[2].partition(b'"')[0]
    return head + b'filename="smime.p7s"\n\n' + text + b"\n\n--" + boundary + b"--\n"


def signature_in(message):
    text = message.partition(b'filename="smime.p7s"\n\n')[2].partition(b"\n\n--")[0]
    return base64.b64decode(text)


def test_a_signature_put_back_is_the_same():
    assert verify(with_signature(signature_in(MESSAGES[0])), CAS[0].certificate).document


@hostile
@given(mutated([signature_in(message) for message in MESSAGES]))
def test_a_document_with_a_mutated_signature(data):
    read_message(with_signature(data))


@hostile
@given(st.integers(0, 400), st.integers(0, 255))
def test_a_document_with_one_byte_of_its_signature_changed(at, value):
    der = bytearray(signature_in(MESSAGES[0]))
    der[at] = value
    read_message(with_signature(bytes(der)))


@hostile
@given(st.binary(max_size=100))
@example(b"\x30\x80" * 100_000)
@example(b"\x30" * 100_000)
@example(b"\x24\x80" * 20 + b"\x04\x82\xff\xff" * 1000)
def test_a_document_with_any_signature(data):
    read_message(with_signature(data))


# The keystore's settings


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    """A keystore."""
    return Keystore.create(
        tmp_path_factory.mktemp("any") / "keystore",
        profile_named("transition"),
        name="Lab",
        domains=DomainSet.of(0),
        validity=YEAR,
        passphrase=None,
        now=NOW,
    )


SETTINGS = json.dumps(
    {"format": 3, "algorithms": [profile_named("transition").to_names()], "domains": "0-9"}
).encode()
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


def open_with(keystore, data):
    (keystore.root / "pqsec.json").write_bytes(data)
    opened = only_ours(lambda: Keystore.open(keystore.root))
    assert opened is None or str(opened.domains)


@hostile
@given(data=st.binary(max_size=100))
@example(data=b"[" * 100_000)
@example(data=b'{"format":' * 100_000)
@example(data=b"1" * 5000)
def test_any_bytes_as_settings(keystore, data):
    open_with(keystore, data)


@hostile
@given(data=mutated([SETTINGS]))
def test_mutated_settings(keystore, data):
    open_with(keystore, data)


@hostile
@given(
    change=st.dictionaries(st.sampled_from(["format", "algorithms", "domains"]), JSON),
    names=st.dictionaries(st.sampled_from(list(profile_named("pq").to_names())), JSON),
)
def test_settings_of_any_shape(keystore, change, names):
    settings = json.loads(SETTINGS)
    settings["algorithms"][0] |= names
    open_with(keystore, json.dumps(settings | change).encode("utf-8", "surrogatepass"))


@hostile
@given(
    data=st.binary(max_size=60)
    | JSON.map(lambda value: json.dumps({"targets": value, "entries": []}).encode())
    | JSON.map(lambda value: json.dumps({"targets": [], "entries": [value]}).encode())
)
def test_any_bytes_as_a_journal(tmp_path_factory, keystore, data):
    root = tmp_path_factory.mktemp("journal")
    (root / "pqsec.json").write_bytes(SETTINGS)
    (root / "private").mkdir()
    (root / ".journal").mkdir()
    (root / ".journal/moves.json").write_bytes(data)
    only_ours(lambda: Keystore.open(root, to_change=True))
    assert keystore.root != root
