"""Bytes: CDR, data holders, generic messages, GUIDs, key material, protected submessages."""

import hashlib
import struct

import pytest

from pqsec_pki.errors import MalformedError, UsageError, VerificationError
from pqsec_pki.handshake import (
    ByteOrder,
    DataHolder,
    GenericMessage,
    IdentityToken,
    KeyMaterial,
    MessageClass,
    PermissionsToken,
    TransformationKind,
    adjusted_guid,
    belongs_to,
    initiates,
    participant_data,
    participant_guid,
    protect,
    unprotect,
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
MATERIAL = KeyMaterial(
    kind=TransformationKind.AES256_GCM,
    salt=b"s" * 32,
    sender_key_id=b"\0\0\0\7",
    sender_key=b"k" * 32,
)


def test_the_octets_that_are_hashed_are_these():
    # handshake.md 1.1: count; name with NUL; value; padding before each length, none after.
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
    # handshake.md 1.2: 120 bytes for "dds.sec.auth", equal to libddsc's plist_ser_generic.
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


def test_the_empty_permissions_token_of_cyclone_is_read():
    empty = PermissionsToken.from_holder(DataHolder("DDS:Access:Permissions:1.0"))
    assert empty == PermissionsToken(None, None)


def test_a_token_of_a_later_minor_version_is_read():
    assert IdentityToken.from_holder(DataHolder("DDS:Auth:PKI-DH:1.2")) == IdentityToken()


@pytest.mark.parametrize("class_id", ["DDS:Auth:PKI-DH:2.0", "DDS:Auth:PSK:1.0", ""])
def test_a_token_of_another_class_is_refused(class_id):
    with pytest.raises(VerificationError, match="is due"):
        IdentityToken.from_holder(DataHolder(class_id))


def test_a_token_with_a_property_twice_is_refused():
    twice = (("dds.cert.sn", "/CN=a"), ("dds.cert.sn", "/CN=b"))
    with pytest.raises(VerificationError, match="twice"):
        IdentityToken.from_holder(DataHolder("DDS:Auth:PKI-DH:1.0", twice))


def test_key_material_of_256_bits_has_88_bytes_and_comes_back():
    assert len(MATERIAL.encode()) == 88
    assert KeyMaterial.from_holder(MATERIAL.to_holder()) == MATERIAL


def test_key_material_with_a_receivers_key_comes_back():
    material = KeyMaterial(
        kind=TransformationKind.AES128_GMAC,
        salt=b"s" * 16,
        sender_key_id=b"1234",
        sender_key=b"k" * 16,
        receiver_key_id=b"5678",
        receiver_key=b"r" * 16,
    )
    assert KeyMaterial.decode(material.encode()) == material


def test_key_material_prints_no_key():
    assert "kkkk" not in repr(MATERIAL)
    assert "ssss" not in repr(MATERIAL)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: b"\0\0\0\5" + data[4:],
        lambda data: b"\0\0\0\2" + data[4:],
        lambda data: data[:4] + b"\0\0\0\x10" + data[24:],
    ],
    ids=["cut", "longer", "unknown kind", "kind of another size", "short salt"],
)
def test_broken_key_material_is_refused(change):
    with pytest.raises(MalformedError):
        KeyMaterial.decode(change(MATERIAL.encode()))


@pytest.mark.parametrize(
    "holder",
    [
        DataHolder("DDS:Crypto:Other", (), (("dds.cryp.keymat", MATERIAL.encode()),)),
        DataHolder("DDS:Crypto:AES_GCM_GMAC"),
        DataHolder("DDS:Crypto:AES_GCM_GMAC", (), (("dds.cryp.keymat", MATERIAL.encode()),) * 2),
    ],
    ids=["another class", "nothing in it", "two in it"],
)
def test_what_is_no_crypto_token_is_refused(holder):
    with pytest.raises(MalformedError, match="crypto token"):
        KeyMaterial.from_holder(holder)


@pytest.mark.parametrize("size", [0, 1, 4, 28, 0xFFF8])
def test_a_protected_submessage_comes_back_and_is_aligned(size):
    plain = b"x" * size
    sealed = protect(MATERIAL, plain)
    assert len(sealed) % 4 == 0
    assert unprotect(MATERIAL, sealed) == plain


def test_no_initialization_vector_is_used_twice():
    sealed = {protect(MATERIAL, b"same")[12:24] for _ in range(50)}
    assert len(sealed) == 50


def test_a_submessage_that_fits_no_length_field_is_refused():
    with pytest.raises(UsageError, match="cannot be protected"):
        protect(MATERIAL, bytes(0xFFF9))


def test_every_flipped_bit_of_a_protected_submessage_is_refused_or_changes_nothing():
    plain = b"one aligned submessage.."
    sealed = protect(MATERIAL, plain)
    # Of the three frames, flag bits that say nothing here may change.
    ignored = {at * 8 + bit for at in (1, 25, 57) for bit in range(1, 8)}
    for place in set(range(len(sealed) * 8)) - ignored:
        changed = bytearray(sealed)
        changed[place // 8] ^= 1 << place % 8
        with pytest.raises((MalformedError, VerificationError)):
            unprotect(MATERIAL, bytes(changed))


def test_every_truncated_protected_submessage_is_refused():
    sealed = protect(MATERIAL, b"one aligned submessage..")
    for size in range(len(sealed)):
        with pytest.raises((MalformedError, VerificationError)):
            unprotect(MATERIAL, sealed[:size])


def test_a_doubled_body_is_refused():
    sealed = protect(MATERIAL, b"data")
    prefix, body, postfix = sealed[:24], sealed[24:36], sealed[36:]
    with pytest.raises(MalformedError, match="4 parts"):
        unprotect(MATERIAL, prefix + body + body + postfix)


def test_a_crypto_header_of_a_wrong_size_is_refused():
    sealed = protect(MATERIAL, b"data")
    with pytest.raises(MalformedError, match="wrong size"):
        unprotect(MATERIAL, b"\x31\0\0\x18" + sealed[4:24] + bytes(4) + sealed[24:])


def test_lengths_in_little_endian_are_read_as_the_flag_says():
    sealed = bytearray(protect(MATERIAL, b"data"))
    for at in (0, 24, 36):
        sealed[at + 1] |= 1
        sealed[at + 2 : at + 4] = sealed[at + 2 : at + 4][::-1]
    assert unprotect(MATERIAL, bytes(sealed)) == b"data"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("salt", b"t" * 32),
        ("sender_key", b"l" * 32),
        ("sender_key_id", b"\0\0\0\x08"),
    ],
)
def test_a_submessage_protected_with_other_material_is_refused(name, value):
    fields = {
        field: getattr(MATERIAL, field) for field in ("kind", "salt", "sender_key_id", "sender_key")
    }
    other = KeyMaterial(**(fields | {name: value}))
    with pytest.raises(VerificationError):
        unprotect(other, protect(MATERIAL, b"data"))


def test_receiver_specific_tags_are_refused_where_there_is_no_receivers_key():
    sealed = protect(MATERIAL, b"data")
    footer = sealed[40:56] + b"\0\0\0\1" + bytes(20)
    with pytest.raises(VerificationError, match="receiver"):
        unprotect(MATERIAL, sealed[:36] + struct.pack(">BBH", 0x32, 0, len(footer)) + footer)


def test_a_kind_of_protection_that_is_not_made_here_is_refused():
    weak = KeyMaterial(
        kind=TransformationKind.AES128_GMAC,
        salt=bytes(16),
        sender_key_id=bytes(4),
        sender_key=bytes(16),
    )
    with pytest.raises(UsageError, match="AES128_GMAC"):
        protect(weak, b"data")
