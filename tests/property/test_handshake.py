"""Whatever comes in, only PqsecError comes out, and what was changed is not believed."""

import contextlib
import struct
import tracemalloc
from functools import cache

import pytest
from cryptography import x509
from hypothesis import assume, example, given
from hypothesis import strategies as st

from pqsec_pki._asn1 import Signed, TBSCertificate, decode, encode, raw
from pqsec_pki.algorithms import KEY_AGREEMENTS, pem
from pqsec_pki.algorithms._diffie_hellman import G, P, Q
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError
from pqsec_pki.handshake import (
    ByteOrder,
    DataHolder,
    Final,
    GenericMessage,
    IdentityToken,
    KeyMaterial,
    PermissionsToken,
    Reply,
    Request,
    Sender,
    key_exchange_material,
    participant_guid,
    reply_to,
    unprotect_payload,
    unprotect_submessage,
)
from pqsec_pki.handshake._cdr import CdrReader, CdrWriter
from pqsec_pki.handshake.wire import MAX_PROPERTIES, MAX_TOKEN, MAX_TOKENS
from tests.fuzz.messages import TARGETS
from tests.fuzz.mutation import blindly
from tests.fuzz.people import NOW, meet
from tests.fuzz.targets import Target
from tests.interop.der import Der

# cryptography warns of what it will refuse some day, and a spoilt certificate may have that.
pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
ORDERS = st.sampled_from(ByteOrder)
SMALL_BYTES = st.binary(max_size=80)
NAMES = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
HOLDERS = st.builds(
    DataHolder,
    NAMES,
    st.lists(st.tuples(NAMES, NAMES), max_size=4).map(tuple),
    st.lists(st.tuples(NAMES, SMALL_BYTES), max_size=4).map(tuple),
)


MET = meet("ecdsa-p256", KEY_AGREEMENTS.named("x25519mlkem768"))
OURS = key_exchange_material(MET.done)
THEIRS = key_exchange_material(MET.awaiting.receive(MET.final))


def answer(holder):
    return reply_to(MET.of_bob, Request.from_holder(holder), now=NOW)


def conclude(holder):
    return MET.waiting.receive(Reply.from_holder(holder), now=NOW)


def believe(holder):
    return MET.awaiting.receive(Final.from_holder(holder))


OPTIONAL = {"hash_c1", "hash_c2", "dh1", "dh2"}
UNSEEN = {("request", "challenge1"), ("request", "dh1")}
"""Nothing vouches for these until the Reply comes back."""
STEPS = {
    "request": (MET.request, answer),
    "reply": (MET.reply, conclude),
    "final": (MET.final, believe),
}


@given(HOLDERS, ORDERS)
def test_a_holder_comes_back_as_it_went(holder, order):
    assert DataHolder.decode(holder.encode(order), order) == holder


@given(st.lists(HOLDERS, max_size=3).map(tuple), st.integers(-(1 << 63), (1 << 63) - 1), ORDERS)
def test_a_message_comes_back_as_it_went(tokens, sequence, order):
    message = GenericMessage(
        source=MET.of_alice.own.guid,
        sequence=sequence,
        destination_participant=MET.of_bob.own.guid,
        class_id="dds.sec.auth",
        tokens=tokens,
    )
    assert GenericMessage.decode(message.encode(order)) == message


@given(st.binary(max_size=300), ORDERS)
def test_any_bytes_are_a_token_or_refused(data, order):
    try:
        holder = DataHolder.decode(data, order)
    except MalformedError:
        return
    # Padding may hold anything, so only the values come back the same.
    assert DataHolder.decode(holder.encode(order), order) == holder


def one_by_one(reader):
    return reader.sequence(lambda: (reader.string(), reader.octets()), MAX_PROPERTIES)


PAIRS = st.lists(st.tuples(NAMES, SMALL_BYTES), max_size=4)


def read_by(how, data, start, order):
    """What comes out, and how much is left; None where it is refused."""
    reader = CdrReader(data, order)
    reader.raw(start)
    try:
        return how(reader), reader.left
    except MalformedError:
        return None


@given(PAIRS, st.binary(max_size=5), st.integers(0, 200), st.binary(max_size=4), ORDERS)
def test_pairs_in_one_go_are_pairs_one_by_one(pairs, head, at, octets, order):
    """Behind a head of any length, spoilt at any place, and cut there."""
    writer = CdrWriter(order)
    writer.raw(head)
    writer.pairs(pairs)
    whole = writer.done()
    for data in (whole, whole[:at], whole[:at] + octets + whole[at + len(octets) :]):
        if len(data) >= len(head):
            found = [
                read_by(how, data, len(head), order)
                for how in (one_by_one, lambda reader: reader.pairs(MAX_PROPERTIES))
            ]
            assert found[0] == found[1]
    assert read_by(one_by_one, whole, len(head), order)[0] == tuple(pairs)


@pytest.mark.parametrize(
    "read",
    [
        GenericMessage.decode,
        KeyMaterial.decode,
        participant_guid,
        lambda data: unprotect_submessage(OURS, data),
        lambda data: unprotect_payload(OURS, data),
    ],
    ids=["message", "key material", "participant data", "submessage", "payload"],
)
@given(data=st.binary(max_size=300))
@example(data=b"\0\1\0\0" + bytes(130))
def test_any_bytes_are_read_or_refused(read, data):
    with contextlib.suppress(MalformedError, VerificationError):
        read(data)


@pytest.mark.parametrize(
    "read", [answer, conclude, believe, IdentityToken.from_holder, PermissionsToken.from_holder]
)
@given(holder=HOLDERS)
def test_any_holder_is_read_or_refused(read, holder):
    with contextlib.suppress(PqsecError):
        read(holder)


@pytest.mark.parametrize("step", STEPS)
@given(data=st.data())
def test_a_message_of_any_values_is_refused(step, data):
    message, take = STEPS[step]
    holder = message.to_holder()
    index = data.draw(st.integers(0, len(holder.binary_properties) - 1), "property")
    name, value = holder.binary_properties[index]
    other = data.draw(
        st.one_of(st.binary(max_size=100), st.binary(min_size=len(value), max_size=len(value))),
        "value",
    )
    assume(other.rstrip(b"\0") != value.rstrip(b"\0"))
    assume((step, name) not in UNSEEN or len(other) != len(value))
    items = list(holder.binary_properties)
    items[index] = (name, other)
    with pytest.raises(PqsecError):
        take(DataHolder(holder.class_id, (), tuple(items)))


@pytest.mark.parametrize("step", STEPS)
@given(data=st.data(), order=ORDERS)
def test_a_message_of_flipped_bits_is_refused_or_says_the_same(step, data, order):
    message, take = STEPS[step]
    sound = message.to_holder()
    octets = bytearray(sound.encode(order))
    for place in data.draw(st.lists(st.integers(0, len(octets) * 8 - 1), min_size=1, max_size=4)):
        octets[place // 8] ^= 1 << place % 8
    try:
        holder = DataHolder.decode(bytes(octets), order)
        take(holder)
    except PqsecError:
        return
    # Padding may have changed, or what is unseen yet; or an optional property lost its name.
    said = dict(holder.binary_properties)
    for name, value in sound.binary_properties:
        lost = name in OPTIONAL and name not in said
        assert lost or (step, name) in UNSEEN or said[name] == value


@given(plain=st.binary(max_size=200))
def test_what_one_protects_the_other_reads(plain):
    assert unprotect_submessage(THEIRS, Sender(OURS).protect_submessage(plain)) == plain


@pytest.mark.parametrize("row", list(KEY_AGREEMENTS), ids=lambda row: row.name)
@given(data=st.data())
def test_any_octets_are_a_public_key_or_refused(row, data):
    size = data.draw(st.sampled_from([row.public_size, row.public_size - 1, 256]), "size")
    public = data.draw(st.binary(min_size=size, max_size=size), "public")
    try:
        ciphertext, secret = row.encapsulate(public)
    except VerificationError:
        return
    assert len(ciphertext) <= row.ciphertext_size
    assert len(secret) <= row.secret_size


PAIRS = {row.name: row.generate() for row in KEY_AGREEMENTS}


@pytest.mark.parametrize("name", PAIRS)
@given(data=st.data())
def test_any_octets_are_a_ciphertext_or_refused(name, data):
    pair = PAIRS[name]
    most = pair.agreement.ciphertext_size
    size = data.draw(st.sampled_from([most, most - 1, 256]), "size")
    ciphertext = data.draw(st.binary(min_size=size, max_size=size), "ciphertext")
    try:
        secret = pair.decapsulate(ciphertext)
    except VerificationError:
        return
    assert len(secret) <= pair.agreement.secret_size


# Real messages, spoilt where it hurts


@cache
def target(name):
    """The target, and bytes that it takes."""
    found = Target(*TARGETS[name])
    return found, found.seeds()


@pytest.mark.parametrize("name", TARGETS)
@given(rng=st.randoms(use_true_random=False), times=st.integers(1, 3))
def test_a_real_message_that_is_spoilt_is_taken_or_refused(name, rng, times):
    target_, seeds = target(name)
    data = rng.choice(seeds)
    for _ in range(times):
        data = target_.spoilt(data, rng, blindly(rng))
    target_.run(data)


# Hostile tokens, as large as may be


def request_with(name, value):
    """The real Request with one other value, and no hash that would tell."""
    holder = MET.request.without_optional().to_holder()
    items = [(key, value if key == name else old) for key, old in holder.binary_properties]
    return DataHolder(holder.class_id, (), tuple(items)).encode()


def filled(name, unit, head=b""):
    """A Request of the most bytes allowed: in one value `head`, then `unit` again and again."""
    room = MAX_TOKEN - len(request_with(name, b"")) - 3
    return request_with(name, (head + unit * (room // len(unit) + 1))[:room])


def certificate_with(**changes):
    """Alice's certificate, its signature no longer good, with other DER in some fields."""
    alice = MET.of_alice.own.certificate
    tbs = decode(TBSCertificate, alice.tbs, "")
    for name, value in changes.items():
        setattr(tbs, name, raw(value))
    signed = decode(Signed, alice.der, "")
    signed.tbs = raw(encode(tbs))
    return request_with("c.id", pem("CERTIFICATE", encode(signed)))


def attribute(tag, value, oid="2.5.4.3"):
    """DER of one part of a name."""
    kind = x509.ObjectIdentifier(oid)
    return Der.of(0x31, Der.of(0x30, encode(kind) + Der.of(tag, value)))


def number(value):
    return Der.of(2, value.to_bytes(value.bit_length() // 8 + 1))


def key_of(oid, *parameters):
    """DER SubjectPublicKeyInfo of a key that is a number."""
    numbers = Der.of(0x30, b"".join(map(number, parameters)))
    public = Der.of(3, b"\0" + number(pow(G, 5, P)))
    return Der.of(0x30, Der.of(0x30, encode(x509.ObjectIdentifier(oid)) + numbers) + public)


NAME = (MAX_TOKEN - (8 << 10)) * 3 // 4
"""Bytes of a name that fill the certificate in PEM."""
HOSTILE = {
    "PEM that begins again and again": filled("c.id", b"-----BEGIN CERTIFICATE-----\n"),
    "PEM without an end": filled("c.id", b"A" * 64 + b"\n", b"-----BEGIN CERTIFICATE-----\n"),
    "a PEM label without an end": filled("c.id", b"A", b"-----BEGIN "),
    "empty PEM": filled("c.id", b"-----BEGIN A-----\n-----END A-----\n"),
    "a name of many parts": certificate_with(
        subject=Der.of(0x30, attribute(12, b"x") * (NAME // len(attribute(12, b"x"))))
    ),
    "a long name": certificate_with(subject=Der.of(0x30, attribute(12, b"," * NAME))),
    "a long name without characters": filled("c.dsign_algo", b"\xff"),
    "a long name of NULs": filled("c.kagree_algo", b"\0"),
    "permissions": filled("c.perm", b"\0"),
    "padding in participant data": filled("c.pdata", bytes(4)),
    "empty participant data": filled("c.pdata", struct.pack(">HH", 0x60, 0)),
    "dh1": filled("dh1", b"\4"),
    "long property names": DataHolder(
        Request.CLASS_ID, (), tuple((f"c.{at}" + "x" * 4200, b"") for at in range(61))
    ).encode(),
    "a long class": DataHolder("\x1b" * (MAX_TOKEN - 16)).encode(),
    "a class and nothing else": b"\0\0\0\2a\0\0\0" + b"\0\0\0\x3f" * (MAX_TOKEN // 4 - 2),
}
MEMORY = 24 << 20
"""Bytes: some copies of the token, and words about it that quote a name three times."""


def take_request(data):
    with contextlib.suppress(PqsecError):
        answer(DataHolder.decode(data))


@pytest.mark.timeout(60)  # what is quadratic takes hours
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_token_as_large_as_may_be_costs_little(name):
    data = HOSTILE[name]
    assert MAX_TOKEN - (16 << 10) < len(data) <= MAX_TOKEN
    tracemalloc.start()
    take_request(data)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < MEMORY


@pytest.mark.parametrize(
    ("over", "words"),
    [
        (DataHolder("c", (), (("n", bytes(MAX_TOKEN)),)).encode(), "larger than"),
        (DataHolder("c", (), (("n", b""),) * (MAX_PROPERTIES + 1)).encode(), "65 elements"),
        (DataHolder("c", (("n", ""),) * (MAX_PROPERTIES + 1)).encode(), "65 elements"),
    ],
    ids=["bytes", "binary properties", "properties"],
)
def test_a_token_over_a_cap_is_refused_before_it_is_read(over, words):
    with pytest.raises(MalformedError, match=words):
        DataHolder.decode(over)


def test_a_message_of_more_tokens_than_the_cap_is_refused():
    message = GenericMessage(
        source=bytes(16),
        sequence=1,
        destination_participant=bytes(16),
        class_id="dds.sec.auth",
        tokens=(DataHolder("c"),) * (MAX_TOKENS + 1),
    )
    with pytest.raises(MalformedError, match="9 elements"):
        GenericMessage.decode(message.encode())


# What fuzzing found


def test_a_name_that_is_a_bit_string_is_read_as_openssl_writes_it():
    data = certificate_with(subject=Der.of(0x30, attribute(3, b"\0x")))
    with pytest.raises(VerificationError, match="certificate of CN=#03020078 is not signed"):
        answer(DataHolder.decode(data))


@pytest.mark.parametrize(
    ("oid", "parameters"),
    [
        ("1.2.840.10046.2.1", (P, G, Q)),
        ("1.2.840.113549.1.3.1", (P, G)),
        ("1.2.840.10040.4.1", (P, Q, G)),
    ],
    ids=["X9.42 DH", "PKCS#3 DH", "DSA"],
)
def test_a_key_of_a_kind_that_signs_nothing_here_is_refused_unread(oid, parameters):
    data = certificate_with(subject_public_key_info=key_of(oid, *parameters))
    with pytest.raises(VerificationError, match=f"keys of algorithm {oid} are not known here"):
        answer(DataHolder.decode(data))
