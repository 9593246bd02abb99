"""Bytes: CDR, data holders, generic messages, GUIDs, tokens of discovery."""

import hashlib
import struct
from dataclasses import replace

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, Family
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.handshake import (
    ByteOrder,
    DataHolder,
    GenericMessage,
    IdentityToken,
    MessageClass,
    PermissionsToken,
    Request,
    adjusted_guid,
    belongs_to,
    initiates,
    participant_data,
    participant_guid,
)
from pqsec_pki.handshake.wire import (
    MAX_PROPERTIES,
    MAX_SAMPLE,
    MAX_TOKEN,
    MAX_TOKENS,
    encode_properties,
)

ORDERS = pytest.mark.parametrize("order", list(ByteOrder), ids=lambda order: order.name)
HOLDER = DataHolder(
    "DDS:Test:1.0", (("key", "välue"), ("none", "")), (("odd", b"12345"), ("empty", b""))
)
GUIDS = [bytes([n]) * 16 for n in range(1, 6)]
MESSAGE = GenericMessage(
    source=GUIDS[0],
    sequence=7,
    related_source=GUIDS[1],
    related_sequence=-1,
    destination_participant=GUIDS[2],
    destination_endpoint=GUIDS[3],
    source_endpoint=GUIDS[4],
    class_id=MessageClass.HANDSHAKE,
    tokens=(HOLDER, DataHolder("second")),
)
SUBJECT = b"0\x0c1\n0\x08\x06\x03U\x04\x03\x0c\x01a"


def test_the_octets_that_are_hashed_are_these():
    # wire.md 3.1: count; name with NUL; value; padding before each length, none after.
    expected = b"\0\0\0\2\0\0\0\5c.id\0\0\0\0\0\0\0\3abc\0\0\0\0\5dh-1\0\0\0\0\0\0\0\1z"
    assert encode_properties([("c.id", b"abc"), ("dh-1", b"z")]) == expected


@ORDERS
def test_a_holder_comes_back_as_it_went(order):
    assert DataHolder.decode(HOLDER.encode(order), order) == HOLDER


def test_a_holder_read_in_the_wrong_byte_order_is_refused():
    with pytest.raises(MalformedError):
        DataHolder.decode(HOLDER.encode(ByteOrder.LITTLE), ByteOrder.BIG)


@ORDERS
def test_every_truncated_holder_is_refused(order):
    data = HOLDER.encode(order)
    for size in range(len(data)):
        with pytest.raises(MalformedError):
            DataHolder.decode(data[:size], order)


def test_bytes_after_a_holder_are_refused():
    with pytest.raises(MalformedError, match="after the token"):
        DataHolder.decode(HOLDER.encode() + b"\0")


@pytest.mark.parametrize("count", [MAX_PROPERTIES + 1, 0xFFFFFFFF, 0x80000000])
def test_a_count_of_properties_that_cannot_be_is_refused(count):
    data = b"\0\0\0\2a\0\0\0" + struct.pack(">I", count) + bytes(4096)
    with pytest.raises(MalformedError, match="elements"):
        DataHolder.decode(data)


@pytest.mark.parametrize("size", [0xFFFFFFFF, 0x7FFFFFFF, 100])
def test_a_length_past_the_end_is_refused(size):
    with pytest.raises(MalformedError, match="past the end"):
        DataHolder.decode(struct.pack(">I", size) + b"DDS:Test\0")


@pytest.mark.parametrize(
    "text", [b"", b"a", b"a\0b\0", b"\xff\0"], ids=["empty", "no NUL", "NUL inside", "not UTF-8"]
)
def test_a_broken_string_is_refused(text):
    data = struct.pack(">I", len(text)) + text + bytes(-len(text) % 4) + bytes(8)
    with pytest.raises(MalformedError, match="string"):
        DataHolder.decode(data)


def test_as_many_properties_as_allowed_are_read_and_one_more_is_not():
    def holder(count):
        return DataHolder("c", (), tuple((f"n{i}", b"") for i in range(count)))

    assert DataHolder.decode(holder(MAX_PROPERTIES).encode()) == holder(MAX_PROPERTIES)
    with pytest.raises(MalformedError):
        DataHolder.decode(holder(MAX_PROPERTIES + 1).encode())


def test_a_token_over_the_limit_is_refused():
    empty = DataHolder("c", (), (("n", b""),))
    room = MAX_TOKEN - len(empty.encode())
    full = DataHolder("c", (), (("n", bytes(room)),))
    assert DataHolder.decode(full.encode()) == full
    with pytest.raises(MalformedError, match="larger than"):
        DataHolder.decode(DataHolder("c", (), (("n", bytes(room + 1)),)).encode())


@ORDERS
def test_a_message_comes_back_as_it_went(order):
    assert GenericMessage.decode(MESSAGE.encode(order)) == MESSAGE


@ORDERS
def test_the_fixed_part_of_a_handshake_message_is_as_libddsc_writes_it(order):
    # wire.md 3.2: 120 bytes for "dds.sec.auth", equal to libddsc's plist_ser_generic.
    sample = MESSAGE.encode(order)
    sign = order.value
    head = {"<": b"\0\1\0\0", ">": b"\0\0\0\0"}[sign]
    numbers = [struct.pack(sign + "q", n) for n in (7, -1)]
    name = struct.pack(sign + "I", 13) + b"dds.sec.auth\0\0\0\0"
    expected = GUIDS[0] + numbers[0] + GUIDS[1] + numbers[1] + b"".join(GUIDS[2:]) + name
    expected += struct.pack(sign + "I", 2)
    assert len(expected) == 120
    assert sample[:124] == head + expected
    assert sample[124:].startswith(HOLDER.encode(order))


@ORDERS
def test_every_truncated_message_is_refused(order):
    data = MESSAGE.encode(order)
    for size in range(len(data)):
        with pytest.raises(MalformedError):
            GenericMessage.decode(data[:size])


def test_a_message_may_be_padded_to_four_bytes_and_no_more():
    data = MESSAGE.encode()
    assert GenericMessage.decode(data + bytes(3)) == MESSAGE
    with pytest.raises(MalformedError, match="after the message"):
        GenericMessage.decode(data + bytes(4))


@pytest.mark.parametrize("header", [b"\0\2\0\0", b"\0\3\0\0", b"\1\0\0\0"])
def test_parameter_lists_and_other_encapsulations_are_refused(header):
    with pytest.raises(MalformedError, match="encapsulation"):
        GenericMessage.decode(header + MESSAGE.encode()[4:])


def test_a_sample_over_the_limit_is_refused():
    with pytest.raises(MalformedError, match="larger than"):
        GenericMessage.decode(b"\0\1\0\0" + bytes(MAX_SAMPLE))


def test_a_message_of_too_many_tokens_is_refused():
    many = GenericMessage(
        source=GUIDS[0],
        sequence=1,
        destination_participant=GUIDS[1],
        class_id=MessageClass.WRITER_CRYPTO_TOKENS,
        tokens=(DataHolder("t"),) * (MAX_TOKENS + 1),
    )
    with pytest.raises(MalformedError, match="elements"):
        GenericMessage.decode(many.encode())


def test_an_adjusted_guid_is_made_from_the_subject_and_the_candidate():
    candidate = bytes(range(12)) + b"\0\0\1\xc1"
    guid = adjusted_guid(SUBJECT, candidate)
    bits = f"{int.from_bytes(hashlib.sha256(SUBJECT).digest()):0256b}"
    assert f"{int.from_bytes(guid[:6]):b}" == "1" + bits[:47]
    assert guid[6:12] == hashlib.sha256(candidate).digest()[:6]
    assert guid[12:] == b"\0\0\1\xc1"


def test_a_guid_belongs_to_one_subject_whatever_its_low_half():
    guid = adjusted_guid(SUBJECT, bytes(16))
    assert belongs_to(guid, SUBJECT)
    assert belongs_to(guid[:6] + bytes(10), SUBJECT)
    assert not belongs_to(bytes([guid[0] ^ 1]) + guid[1:], SUBJECT)
    assert not belongs_to(bytes([guid[0] & 0x7F]) + guid[1:], SUBJECT)
    assert not belongs_to(guid, SUBJECT[:-1] + b"b")


def test_the_smaller_guid_initiates_and_equal_ones_do_not():
    small, large = b"\x80" + bytes(15), b"\x80" + bytes(14) + b"\1"
    assert initiates(small, large)
    assert not initiates(large, small)
    assert not initiates(small, small)


def test_participant_data_holds_the_guid_and_nothing_else():
    guid = bytes(range(16))
    assert participant_data(guid) == bytes.fromhex("00500010") + guid + bytes.fromhex("00010000")
    assert participant_guid(participant_data(guid)) == guid


def test_a_guid_is_found_behind_other_parameters_of_odd_size():
    guid = bytes(range(16))
    data = bytes.fromhex("10010005") + b"12345\0\0\0" + participant_data(guid)
    assert participant_guid(data) == guid


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no participant GUID"),
        (bytes.fromhex("00010000"), "no participant GUID"),
        (bytes.fromhex("00010000") + participant_data(bytes(16)), "no participant GUID"),
        (participant_data(bytes(16))[:19], "past the end"),
        (bytes.fromhex("0050ffff") + bytes(16), "past the end"),
        (bytes.fromhex("00500010"), "past the end"),
        (bytes.fromhex("00500008") + bytes(8), "8 bytes"),
    ],
    ids=["empty", "sentinel", "after the sentinel", "cut", "huge", "no value", "short"],
)
def test_broken_participant_data_is_refused(data, words):
    with pytest.raises(MalformedError, match=words):
        participant_guid(data)


def test_an_identity_token_comes_back_and_any_property_may_be_absent():
    token = IdentityToken("/CN=a", "EC-prime256v1", None, "RSA-2048")
    holder = token.to_holder()
    assert [name for name, _ in holder.properties] == [
        "dds.cert.sn",
        "dds.cert.algo",
        "dds.ca.algo",
    ]
    assert IdentityToken.from_holder(holder) == token


def test_a_sample_that_ends_in_its_header_is_told_from_one_that_ends_behind_it():
    with pytest.raises(MalformedError, match="not CDR: unknown encapsulation"):
        GenericMessage.decode(b"\0\1\0")
    with pytest.raises(MalformedError, match=r"^(?!not CDR)"):
        GenericMessage.decode(b"\0\1\0\0")


def test_a_token_tells_which_requests_its_sender_can_take():
    ecdh, mlkem, other = (
        KEY_AGREEMENTS.named(name) for name in ("ecdh-p256", "ml-kem-768", "ml-kem-1024")
    )
    stock = IdentityToken("/CN=a", "EC-prime256v1", None, "RSA-2048")
    announced = replace(stock, agreements=f"{ecdh.wire_name},{mlkem.wire_name}")

    assert [stock.knows(each) for each in (ecdh, mlkem, other)] == [True, False, False]
    assert [announced.knows(each) for each in (ecdh, mlkem, other)] == [True, True, False]
    quantum = replace(stock, algorithm=SIGNATURES.named("ml-dsa-65").token_name)
    assert [quantum.knows(each) for each in (ecdh, mlkem)] == [True, True]
    for row in SIGNATURES:
        known = replace(stock, algorithm=row.token_name).knows(mlkem)
        assert known == (row.family is not Family.CLASSICAL), row.name


def test_the_empty_permissions_token_of_cyclone_is_read():
    empty = PermissionsToken.from_holder(DataHolder("DDS:Access:Permissions:1.0"))
    assert empty == PermissionsToken(None, None)


def test_a_token_of_a_later_minor_version_is_read():
    assert IdentityToken.from_holder(DataHolder("DDS:Auth:PKI-DH:1.2")) == IdentityToken()


@pytest.mark.parametrize("class_id", ["DDS:Auth:PKI-DH:2.0", "DDS:Auth:PSK:1.0", ""])
def test_a_token_of_another_class_is_refused(class_id):
    with pytest.raises(VerificationError, match="expected a"):
        IdentityToken.from_holder(DataHolder(class_id))


def test_a_token_with_a_property_twice_is_refused():
    twice = (("dds.cert.sn", "/CN=a"), ("dds.cert.sn", "/CN=b"))
    with pytest.raises(VerificationError, match="twice"):
        IdentityToken.from_holder(DataHolder("DDS:Auth:PKI-DH:1.0", twice))


@pytest.mark.parametrize("name", ["c.dsign_algo", "c.kagree_algo"])
def test_a_name_of_an_algorithm_that_is_endless_is_refused_unquoted(name):
    holder = DataHolder(Request.CLASS_ID, (), ((name, b"x" * 250_000),))
    with pytest.raises(VerificationError, match=f"{name} has 250000 bytes") as refusal:
        Request.from_holder(holder)
    assert len(str(refusal.value)) < 500


def test_what_a_peer_calls_things_is_quoted_short_and_without_control_characters():
    holder = DataHolder("\u009b2J" * 50_000, (), (("\u202e" * 50_000, b""),) * 2)
    with pytest.raises(VerificationError, match=r"u009b2J") as refusal:
        Request.from_holder(holder)
    assert len(str(refusal.value)) < 1500
    assert str(refusal.value).isprintable()


def test_two_guids_in_the_participant_data_are_refused():
    one, other = (participant_data(bytes([n]) * 16) for n in (1, 2))
    with pytest.raises(MalformedError, match="two participant GUIDs"):
        participant_guid(one[:-4] + other)
