"""What Cyclone DDS's crypto plugin protected, read without it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    KeyMaterial,
    Sender,
    TransformationKind,
    unprotect_payload,
    unprotect_submessage,
)

FILE = Path(__file__).parent / "protection" / "cyclone.json"
CAPTURES = json.loads(FILE.read_text())
WITH_ORIGIN = [each for each in CAPTURES if "origin" in each["protection"]]


def for_each(captures):
    return pytest.mark.parametrize("capture", captures, ids=lambda each: each["protection"])


every = for_each(CAPTURES)
MATERIALS = ("writer_keys", "writer_keys_for_another", "reader_keys")


def octets(capture, name):
    return bytes.fromhex(capture[name])


def keys(capture, name):
    return [KeyMaterial.decode(bytes.fromhex(each)) for each in capture[name]]


def test_every_kind_is_there_with_and_without_origin_authentication():
    seen = {
        (keys(each, "writer_keys")[0].kind, "origin" in each["protection"]) for each in CAPTURES
    }
    assert seen == {(kind, origin) for kind in set(TransformationKind) - {0} for origin in (0, 1)}


@every
@pytest.mark.parametrize("name", MATERIALS)
def test_key_material_is_read_and_written_octet_for_octet(capture, name):
    assert [each.encode().hex() for each in keys(capture, name)] == capture[name]


@every
def test_a_writers_submessage_is_read_by_each_of_its_readers(capture):
    sealed, plain = octets(capture, "writer_submessage"), octets(capture, "submessage")
    for name in ("writer_keys", "writer_keys_for_another"):
        assert unprotect_submessage(keys(capture, name)[0], sealed) == plain


@every
def test_a_readers_submessage_is_read(capture):
    sealed, plain = octets(capture, "reader_submessage"), octets(capture, "submessage")
    assert unprotect_submessage(keys(capture, "reader_keys")[0], sealed) == plain


@every
def test_a_payload_is_read_with_the_second_key(capture):
    submessages, payloads = keys(capture, "writer_keys")
    sealed = octets(capture, "writer_payload")
    assert unprotect_payload(payloads, sealed) == octets(capture, "payload")
    with pytest.raises(VerificationError, match="a key of another name"):
        unprotect_payload(submessages, sealed)


@every
def test_what_we_protect_has_the_same_form(capture):
    readers = [keys(capture, name)[0] for name in MATERIALS[:2]]
    receivers = [each for each in readers if each.receiver_key]
    ours = Sender(readers[0]).protect_submessage(octets(capture, "submessage"), receivers=receivers)
    assert form(ours) == form(octets(capture, "writer_submessage"))
    ours = Sender(keys(capture, "writer_keys")[1]).protect_payload(octets(capture, "payload"))
    theirs = octets(capture, "writer_payload")
    assert (ours[:8], len(ours)) == (theirs[:8], len(theirs))


def form(sealed):
    """Kinds and contents' sizes of the submessages; what the crypto header names."""
    sizes, at = [], 0
    while at < len(sealed):
        order = "little" if sealed[at + 1] & 1 else "big"
        sizes.append((sealed[at], int.from_bytes(sealed[at + 2 : at + 4], order)))
        at += 4 + sizes[-1][1]
    return sizes, sealed[4:12]


@for_each(WITH_ORIGIN)
def test_a_tag_for_somebody_else_is_not_enough(capture):
    [key] = keys(capture, "reader_keys")
    other = replace(key, receiver_key_id=b"\xff" * 4)
    with pytest.raises(VerificationError, match="no tag for this receiver"):
        unprotect_submessage(other, octets(capture, "reader_submessage"))
