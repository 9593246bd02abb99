"""Whatever is protected comes back; whatever else comes is refused, and with our errors only."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.handshake import (
    KeyMaterial,
    Sender,
    TransformationKind,
    unprotect_payload,
    unprotect_submessage,
)

REFUSED = (MalformedError, VerificationError)
MATERIALS = [KeyMaterial.generate(kind) for kind in TransformationKind if kind]
MATERIALS += [material.for_receiver() for material in MATERIALS]
EITHER = st.sampled_from([unprotect_submessage, unprotect_payload])
ANY_MATERIAL = st.sampled_from([*MATERIALS, KeyMaterial.generate(TransformationKind.NONE)])
WORDS = st.binary(max_size=50).map(lambda data: data * 4)
"""Multiples of four bytes."""


@st.composite
def submessages(draw):
    """One of any kind but those of protection, in either byte order."""
    kind = draw(st.integers(0, 255).filter(lambda kind: kind not in range(0x30, 0x33)))
    flags, content = draw(st.integers(0, 255)), draw(WORDS)
    return struct.pack("<BBH" if flags & 1 else ">BBH", kind, flags, len(content)) + content


@st.composite
def lookalikes(draw, material):
    """Frames, sizes and names as they should be, and anything in them."""
    identifier = struct.pack(">I", material.kind) + material.sender_key_id
    count = draw(st.integers(0, 3) | st.integers(0, (1 << 32) - 1))
    length = draw(st.integers(0, 60) | st.integers(0, (1 << 32) - 1))
    body = struct.pack(">I", length) + draw(st.binary(max_size=60))
    footer = draw(st.binary(min_size=16, max_size=16)) + struct.pack(">I", count)
    footer += draw(st.binary(max_size=60) | st.just(material.receiver_key_id * 5))
    iv = draw(st.binary(min_size=12, max_size=12))
    contents = (0x31, identifier + iv), (draw(st.sampled_from([0x15, 0x30])), body), (0x32, footer)
    if draw(st.booleans()):
        return b"".join(struct.pack(">BBH", kind, 0, len(data)) + data for kind, data in contents)
    return b"".join(data for _, data in contents)


@given(material=st.sampled_from(MATERIALS), plain=submessages(), others=st.integers(0, 3))
def test_a_submessage_comes_back(material, plain, others):
    receivers = [material.for_receiver() for _ in range(others)] if material.receiver_key else []
    receivers += [material] if material.receiver_key else []
    sealed = Sender(material).protect_submessage(plain, receivers=receivers)
    assert len(sealed) % 4 == 0
    assert unprotect_submessage(material, sealed) == plain


@given(material=st.sampled_from(MATERIALS), plain=WORDS, odd=st.binary(max_size=3))
def test_a_payload_comes_back(material, plain, odd):
    plain += odd * material.kind.encrypts
    sealed = Sender(material).protect_payload(plain)
    assert unprotect_payload(material, sealed) == plain


@given(kind=st.sampled_from(TransformationKind), with_receiver=st.booleans())
def test_key_material_comes_back(kind, with_receiver):
    material = KeyMaterial.generate(kind)
    if kind and with_receiver:
        material = material.for_receiver()
    assert KeyMaterial.decode(material.encode()) == material


@given(data=st.data(), material=st.sampled_from(MATERIALS))
def test_key_material_with_changed_octets_is_refused_or_reads_as_written(data, material):
    octets = bytearray(material.encode())
    for at in data.draw(st.lists(st.integers(0, len(octets) - 1), min_size=1, max_size=3), "at"):
        octets[at] = data.draw(st.integers(0, 255), "octet")
    try:
        found = KeyMaterial.decode(bytes(octets))
    except MalformedError:
        return
    assert found.encode() == octets


@given(unprotect=EITHER, material=ANY_MATERIAL, data=st.binary(max_size=200))
def test_any_bytes_are_refused(unprotect, material, data):
    with pytest.raises(REFUSED):
        unprotect(material, data)


@given(unprotect=EITHER, material=ANY_MATERIAL, data=st.data())
def test_what_only_looks_protected_is_refused(unprotect, material, data):
    with pytest.raises(REFUSED):
        unprotect(material, data.draw(lookalikes(material), "data"))


@given(material=st.sampled_from(MATERIALS), data=st.data())
def test_a_submessage_put_together_from_two_is_refused(material, data):
    receivers = [material] if material.receiver_key else []
    sender = Sender(material)
    one, two = (
        sender.protect_submessage(bytes([0x15, 0, 0, 8]) + each * 8, receivers=receivers)
        for each in (b"a", b"b")
    )
    cuts = sorted(data.draw(st.tuples(*[st.integers(0, len(one))] * 2), "cuts"))
    mixed = one[: cuts[0]] + two[cuts[0] : cuts[1]] + one[cuts[1] :]
    if mixed not in {one, two}:
        with pytest.raises(REFUSED):
            unprotect_submessage(material, mixed)


@given(unprotect=EITHER, material=st.sampled_from(MATERIALS), data=st.data())
def test_what_was_changed_is_refused_or_says_the_same(unprotect, material, data):
    plain = b"\x15\0\0\4data"
    receivers = [material] if material.receiver_key else []
    sender = Sender(material)
    sealed = {
        unprotect_submessage: sender.protect_submessage(plain, receivers=receivers),
        unprotect_payload: sender.protect_payload(plain),
    }[unprotect]
    octets = bytearray(sealed)
    for place in data.draw(st.lists(st.integers(0, len(octets) * 8 - 1), max_size=4), "places"):
        octets[place // 8] ^= 1 << place % 8
    try:
        assert unprotect(material, bytes(octets)) == plain
    except REFUSED:
        assert octets != sealed
