"""Key material, and what is protected with it: submessages and payloads."""

import hmac
import struct
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from pqsec_pki.errors import MalformedError, UsageError, VerificationError
from pqsec_pki.handshake import (
    DataHolder,
    KeyMaterial,
    Sender,
    TransformationKind,
    unprotect_payload,
    unprotect_submessage,
)
from pqsec_pki.handshake._secured import MAX_RECEIVERS
from pqsec_pki.handshake.protection import MAX_PAYLOAD

KINDS = [kind for kind in TransformationKind if kind]
SIGNED, ENCRYPTED = KINDS[::2], KINDS[1::2]
PLAIN = bytes.fromhex("15051400") + bytes(range(20))
"""A DATA submessage, little-endian."""
MATERIAL = KeyMaterial(
    kind=TransformationKind.AES256_GCM,
    salt=b"s" * 32,
    sender_key_id=b"\0\0\0\7",
    sender_key=b"k" * 32,
)
NONE = KeyMaterial.generate(TransformationKind.NONE)
REFUSED = (MalformedError, VerificationError)
every_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
signed = pytest.mark.parametrize("kind", SIGNED, ids=lambda kind: kind.name)
encrypted = pytest.mark.parametrize("kind", ENCRYPTED, ids=lambda kind: kind.name)


def seal(material, plain=PLAIN, receivers=()):
    return Sender(material).protect_submessage(plain, receivers=receivers)


def flipped(data, place):
    changed = bytearray(data)
    changed[place // 8] ^= 1 << place % 8
    return bytes(changed)


def frame(kind, content):
    return struct.pack(">BBH", kind, 0, len(content)) + content


# Key material


def test_key_material_of_256_bits_has_88_bytes_and_comes_back():
    assert len(MATERIAL.encode()) == 88
    assert KeyMaterial.from_holder(MATERIAL.to_holder()) == MATERIAL


@pytest.mark.parametrize("kind", list(TransformationKind), ids=lambda kind: kind.name)
def test_new_key_material_comes_back(kind):
    material = KeyMaterial.generate(kind)
    assert KeyMaterial.decode(material.encode()) == material
    assert len(material.sender_key) == {"N": 0, "1": 16, "2": 32}[kind.name.removeprefix("AES")[0]]


@every_kind
def test_key_material_with_a_receivers_key_comes_back(kind):
    material = KeyMaterial.generate(kind).for_receiver()
    assert len(material.receiver_key) == kind.key_size
    assert KeyMaterial.decode(material.encode()) == material


def test_new_key_material_is_new_each_time():
    one, two = (KeyMaterial.generate(TransformationKind.AES256_GCM) for _ in range(2))
    for name in ("salt", "sender_key", "sender_key_id"):
        assert getattr(one, name) != getattr(two, name)
    first, second = one.for_receiver(), one.for_receiver()
    for name in ("receiver_key", "receiver_key_id"):
        assert getattr(first, name) != getattr(second, name)
    assert replace(first, receiver_key_id=bytes(4), receiver_key=b"") == one


def test_key_material_prints_no_key():
    shown = repr(replace(MATERIAL, receiver_key_id=b"1234", receiver_key=b"r" * 32))
    assert not any(each * 4 in shown for each in "skr")


def test_key_material_of_no_kind_is_read_with_the_zeros_that_fast_dds_adds():
    assert KeyMaterial.decode(bytes(44)) == KeyMaterial.decode(bytes(24))


WITH_RECEIVER = MATERIAL.for_receiver().encode()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        MATERIAL.encode()[:-1],
        MATERIAL.encode() + b"\0",
        MATERIAL.encode() + bytes(20),
        b"\0\0\0\5" + MATERIAL.encode()[4:],
        b"\0\0\0\2" + MATERIAL.encode()[4:],
        MATERIAL.encode()[:4] + b"\0\0\0\x10" + MATERIAL.encode()[24:],
        MATERIAL.encode()[:-8] + b"1234" + bytes(4),
        WITH_RECEIVER[:-40] + bytes(4) + WITH_RECEIVER[-36:],
        bytes(25),
        bytes(43) + b"\1",
    ],
    ids=[
        "empty",
        "cut",
        "longer",
        "much longer",
        "unknown kind",
        "kind of another size",
        "short salt",
        "receiver without key",
        "key without receiver",
        "no kind, longer",
        "no kind, not all zero",
    ],
)
def test_broken_key_material_is_refused(data):
    with pytest.raises(MalformedError):
        KeyMaterial.decode(data)


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


def test_there_is_no_session_key_for_a_receiver_without_a_key():
    with pytest.raises(UsageError, match="no receiver's key"):
        MATERIAL.session_receiver_key(bytes(4))


# Submessages


@every_kind
def test_a_protected_submessage_comes_back_and_is_aligned(kind):
    material = KeyMaterial.generate(kind)
    sealed = seal(material)
    assert len(sealed) % 4 == 0
    assert unprotect_submessage(material, sealed) == PLAIN
    assert (PLAIN in sealed) != kind.encrypts


@pytest.mark.parametrize("size", [0, 1, 4, 28, 0xFFF8])
def test_an_encrypted_submessage_may_be_any_bytes(size):
    assert unprotect_submessage(MATERIAL, seal(MATERIAL, b"x" * size)) == b"x" * size


@signed
@pytest.mark.parametrize(
    "plain",
    [
        b"",
        b"data",
        b"\x15\0\0\x05data",
        b"\x15\0\0\0data",
        b"\x15\0\0\3abc",
        b"\x15\1\0\4data",
        PLAIN + PLAIN,
        frame(0x30, b"data"),
        frame(0x31, bytes(20)),
        frame(0x32, bytes(20)),
    ],
    ids=[
        "nothing",
        "half a header",
        "longer than it is",
        "of no said size",
        "not aligned",
        "in the wrong byte order",
        "two",
        "SEC_BODY",
        "SEC_PREFIX",
        "SEC_POSTFIX",
    ],
)
def test_what_is_not_one_whole_submessage_cannot_be_signed(kind, plain):
    with pytest.raises(UsageError, match="one whole submessage"):
        seal(KeyMaterial.generate(kind), plain)


@signed
@pytest.mark.parametrize("plain", [PLAIN, b"\x15\0\0\4data", b"\x15\1\4\0data", b"\x01\1\0\0"])
def test_a_submessage_in_either_byte_order_can_be_signed(kind, plain):
    material = KeyMaterial.generate(kind)
    assert unprotect_submessage(material, seal(material, plain)) == plain


def test_a_submessage_that_fits_no_length_field_is_refused():
    with pytest.raises(UsageError, match="cannot be protected"):
        seal(MATERIAL, bytes(0xFFF9))


@every_kind
def test_every_flipped_bit_of_a_protected_submessage_is_refused_or_changes_nothing(kind):
    material = KeyMaterial.generate(kind).for_receiver()
    sealed = seal(material, receivers=[material])
    frames = [0, 24, 32 + len(PLAIN)] if kind.encrypts else [0, 24 + len(PLAIN)]
    # Of the frames, flag bits that say nothing here may change.
    ignored = {at * 8 + 8 + bit for at in frames for bit in range(1, 8)}
    for place in set(range(len(sealed) * 8)) - ignored:
        with pytest.raises(REFUSED):
            unprotect_submessage(material, flipped(sealed, place))
    for place in ignored:
        assert unprotect_submessage(material, flipped(sealed, place)) == PLAIN


@every_kind
def test_every_truncated_protected_submessage_is_refused(kind):
    material = KeyMaterial.generate(kind)
    sealed = seal(material)
    for size in range(len(sealed)):
        with pytest.raises(REFUSED):
            unprotect_submessage(material, sealed[:size])


@pytest.mark.parametrize("order", ["0112", "0120", "102", "021", "210", "011", "02", "0", ""])
def test_parts_doubled_missing_or_in_another_order_are_refused(order):
    sealed = seal(MATERIAL)
    parts = sealed[:24], sealed[24:-24], sealed[-24:]
    with pytest.raises(MalformedError, match=f"{len(order)} parts"):
        unprotect_submessage(MATERIAL, b"".join(parts[int(each)] for each in order))


def test_a_crypto_header_of_a_wrong_size_is_refused():
    sealed = seal(MATERIAL)
    with pytest.raises(MalformedError, match="wrong size"):
        unprotect_submessage(MATERIAL, frame(0x31, sealed[4:24] + bytes(4)) + sealed[24:])


def test_more_than_padding_after_the_ciphertext_is_refused():
    sealed = seal(MATERIAL)
    body = frame(0x30, sealed[28:-24] + bytes(4))
    with pytest.raises(MalformedError, match="after the encrypted content"):
        unprotect_submessage(MATERIAL, sealed[:24] + body + sealed[-24:])


def test_lengths_in_little_endian_are_read_as_the_flag_says():
    sealed = bytearray(seal(MATERIAL))
    for at in (0, 24, len(sealed) - 24):
        sealed[at + 1] |= 1
        sealed[at + 2 : at + 4] = sealed[at + 2 : at + 4][::-1]
    assert unprotect_submessage(MATERIAL, bytes(sealed)) == PLAIN


@every_kind
@pytest.mark.parametrize("name", ["salt", "sender_key", "sender_key_id"])
def test_a_submessage_protected_with_other_material_is_refused(kind, name):
    material, stranger = KeyMaterial.generate(kind), KeyMaterial.generate(kind)
    other = replace(material, **{name: getattr(stranger, name)})
    with pytest.raises(VerificationError):
        unprotect_submessage(other, seal(material))


@every_kind
def test_a_submessage_of_another_kind_of_protection_is_refused(kind):
    for other in KINDS:
        if other is not kind and other.key_size == kind.key_size:
            material = KeyMaterial.generate(kind)
            with pytest.raises(VerificationError, match="another way"):
                unprotect_submessage(material, seal(replace(material, kind=other)))


@pytest.mark.parametrize("kind", [3, 4])
def test_an_encrypted_body_under_a_signed_kinds_header_and_the_reverse_are_refused(kind):
    material = replace(MATERIAL, kind=TransformationKind(kind))
    sealed = seal(replace(MATERIAL, kind=TransformationKind(7 - kind)))
    disguised = sealed[:4] + struct.pack(">I", kind) + sealed[8:]
    with pytest.raises(MalformedError, match="encrypted"):
        unprotect_submessage(material, disguised)


@pytest.mark.parametrize("use", [unprotect_submessage, unprotect_payload])
def test_with_key_material_of_no_kind_nothing_is_believed(use):
    header = bytes(4) + NONE.sender_key_id + bytes(12)
    submessage = frame(0x31, header) + PLAIN + frame(0x32, bytes(20))
    data = {unprotect_submessage: submessage, unprotect_payload: header + bytes(24)}
    with pytest.raises(VerificationError, match="protects nothing"):
        use(NONE, data[use])


def test_with_key_material_of_no_kind_nothing_is_sent():
    with pytest.raises(UsageError, match="protects nothing"):
        Sender(NONE)


# Receivers


@every_kind
def test_the_tag_of_a_receiver_is_the_mac_of_the_common_tag_under_its_own_key(kind):
    # DDS-Security 1.1, 9.5.3.3.3 and 9.5.3.3.4, computed again.
    material = KeyMaterial.generate(kind).for_receiver()
    sealed = seal(material, receivers=[material])
    iv, common = sealed[12:24], sealed[-40:-24]
    label = b"SessionReceiverKey" + material.salt + iv[:4]
    key = hmac.digest(material.receiver_key, label, "sha256")[: kind.key_size]
    tag = AESGCM(key).encrypt(iv, b"", common)
    assert sealed[-24:] == b"\0\0\0\1" + material.receiver_key_id + tag


@every_kind
def test_each_receiver_finds_its_own_tag(kind):
    material = KeyMaterial.generate(kind)
    receivers = [material.for_receiver() for _ in range(5)]
    sealed = seal(material, receivers=receivers)
    assert {unprotect_submessage(each, sealed) for each in receivers} == {PLAIN}
    with pytest.raises(VerificationError, match="no tag for this receiver"):
        unprotect_submessage(material.for_receiver(), sealed)


@every_kind
def test_a_submessage_without_tags_is_refused_by_who_has_a_receivers_key(kind):
    material = KeyMaterial.generate(kind)
    with pytest.raises(VerificationError, match="no tag for this receiver"):
        unprotect_submessage(material.for_receiver(), seal(material))


@every_kind
def test_a_receiver_cannot_play_the_sender_to_another(kind):
    material = KeyMaterial.generate(kind)
    one, two = material.for_receiver(), material.for_receiver()
    forged = seal(one, receivers=[replace(one, receiver_key_id=two.receiver_key_id)])
    with pytest.raises(VerificationError, match="no tag for this receiver"):
        unprotect_submessage(two, forged)


@every_kind
def test_a_tag_of_another_submessage_is_refused(kind):
    material = KeyMaterial.generate(kind).for_receiver()
    one, two = (seal(material, receivers=[material]) for _ in range(2))
    with pytest.raises(VerificationError, match="no tag for this receiver"):
        unprotect_submessage(material, one[:-16] + two[-16:])


def test_a_right_tag_behind_a_wrong_one_of_the_same_name_counts():
    material = MATERIAL.for_receiver()
    sealed = seal(material, receivers=[material])
    footer = sealed[-40:-24] + b"\0\0\0\2" + sealed[-20:-16] + bytes(16) + sealed[-20:]
    assert unprotect_submessage(material, sealed[:-44] + frame(0x32, footer)) == PLAIN


def test_receiver_specific_tags_are_refused_where_there_is_no_receivers_key():
    sealed = seal(MATERIAL, receivers=[MATERIAL.for_receiver()])
    with pytest.raises(VerificationError, match="where there is no receiver's key"):
        unprotect_submessage(MATERIAL, sealed)


@pytest.mark.parametrize("count", [0, 2, 0xFFFFFFFF, 0x80000000], ids=hex)
def test_a_count_of_receivers_that_is_not_true_is_refused(count):
    material = MATERIAL.for_receiver()
    sealed = seal(material, receivers=[material])
    with pytest.raises(MalformedError, match="crypto footer"):
        unprotect_submessage(material, sealed[:-24] + struct.pack(">I", count) + sealed[-20:])


def test_as_many_receivers_as_have_room_are_served_and_one_more_is_not():
    receivers = [MATERIAL.for_receiver()] * MAX_RECEIVERS
    assert unprotect_submessage(receivers[0], seal(MATERIAL, receivers=receivers)) == PLAIN
    with pytest.raises(UsageError, match="have room"):
        seal(MATERIAL, receivers=[*receivers, receivers[0]])


@pytest.mark.parametrize(
    "receiver",
    [KeyMaterial.generate(TransformationKind.AES256_GCM).for_receiver(), MATERIAL],
    ids=["of another sender", "without key"],
)
def test_a_receiver_that_is_none_of_the_senders_is_refused(receiver):
    with pytest.raises(UsageError, match="not of this sender"):
        seal(MATERIAL, receivers=[receiver])


# Payloads


@every_kind
@pytest.mark.parametrize("size", [0, 4, 1000, 1 << 17])
def test_a_protected_payload_comes_back(kind, size):
    material = KeyMaterial.generate(kind)
    payload = b"p" * size
    sealed = Sender(material).protect_payload(payload)
    assert unprotect_payload(material, sealed) == payload
    assert len(sealed) == 20 + 4 * kind.encrypts + size + 20


@encrypted
@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_the_count_behind_an_encrypted_payload_of_odd_size_is_aligned(kind, size):
    # As Fast DDS and OpenDDS write it, by the rules of CDR.
    material = KeyMaterial.generate(kind)
    sealed = Sender(material).protect_payload(b"p" * size)
    assert len(sealed) % 4 == 0
    assert unprotect_payload(material, sealed) == b"p" * size


@signed
@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_a_payload_that_is_not_padded_cannot_be_signed(kind, size):
    with pytest.raises(UsageError, match="multiples of 4"):
        Sender(KeyMaterial.generate(kind)).protect_payload(bytes(size))


@every_kind
def test_every_flipped_bit_of_a_protected_payload_is_refused(kind):
    material = KeyMaterial.generate(kind)
    sealed = Sender(material).protect_payload(b"payload.")
    for place in range(len(sealed) * 8):
        with pytest.raises(REFUSED):
            unprotect_payload(material, flipped(sealed, place))


@every_kind
def test_every_truncated_or_lengthened_payload_is_refused(kind):
    material = KeyMaterial.generate(kind)
    sealed = Sender(material).protect_payload(b"payload.")
    for changed in (*(sealed[:size] for size in range(len(sealed))), sealed + bytes(4)):
        with pytest.raises(REFUSED):
            unprotect_payload(material, changed)


@every_kind
def test_a_payload_with_tags_of_receivers_is_refused(kind):
    material = KeyMaterial.generate(kind)
    sealed = Sender(material).protect_payload(b"payload.")
    with pytest.raises(REFUSED):
        unprotect_payload(material, sealed[:-4] + b"\0\0\0\1" + bytes(20))


def test_a_payload_that_is_too_large_is_refused_before_it_is_looked_at():
    with pytest.raises(UsageError, match="cannot be protected"):
        Sender(MATERIAL).protect_payload(bytes(MAX_PAYLOAD + 1))
    with pytest.raises(MalformedError, match="cannot be a protected payload"):
        unprotect_payload(MATERIAL, bytes(MAX_PAYLOAD + 100))


# Initialization vectors


def test_a_sender_counts_and_repeats_no_initialization_vector():
    sender = Sender(MATERIAL)
    made = [sender.protect_submessage(PLAIN)[12:24] for _ in range(50)]
    made += [sender.protect_payload(PLAIN)[8:20] for _ in range(50)]
    assert len({iv[:4] for iv in made}) == 1
    first = int.from_bytes(made[0][4:])
    counted = [(first + number) % (1 << 64) for number in range(100)]
    assert [int.from_bytes(iv[4:]) for iv in made] == counted


def test_two_senders_of_one_key_begin_elsewhere():
    begun = {seal(MATERIAL)[12:24] for _ in range(50)}
    assert len(begun) == 50
    assert len({iv[:4] for iv in begun}) > 40
    assert len({iv[4:] for iv in begun}) == 50


def test_threads_that_share_a_sender_share_no_initialization_vector():
    sender = Sender(MATERIAL, blocks_per_session=7)
    with ThreadPoolExecutor(8) as pool:
        sealed = list(pool.map(sender.protect_submessage, [PLAIN] * 4000))
    assert len({each[12:24] for each in sealed}) == 4000
    assert all(unprotect_submessage(MATERIAL, each) == PLAIN for each in sealed)


def test_a_session_ends_after_its_blocks_and_the_suffix_counts_on():
    sender = Sender(MATERIAL, blocks_per_session=6)
    made = [sender.protect_submessage(PLAIN)[12:24] for _ in range(12)]
    # Two blocks each, so three submessages a session.
    sessions = Counter(iv[:4] for iv in made)
    assert list(sessions.values()) == [3, 3, 3, 3]
    first, *_ = numbers = [int.from_bytes(each) for each in sessions]
    assert numbers == [(first + number) % (1 << 32) for number in range(4)]
    assert len({iv[4:] for iv in made}) == 12


def test_what_is_larger_than_a_session_is_one_of_its_own():
    sender = Sender(MATERIAL, blocks_per_session=2)
    sealed = [sender.protect_payload(bytes(1000)) for _ in range(3)]
    assert len({each[8:12] for each in sealed}) == 3
    assert all(unprotect_payload(MATERIAL, each) == bytes(1000) for each in sealed)


def test_session_and_suffix_go_round():
    sender = Sender(MATERIAL, blocks_per_session=2)
    sender.protect_payload(PLAIN)
    sender._session, sender._suffix = b"\xff" * 4, (1 << 64) - 1
    assert sender.protect_payload(PLAIN)[8:20] == bytes(12)
