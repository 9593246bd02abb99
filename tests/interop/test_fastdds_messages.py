"""What Fast DDS refuses in our handshake messages and what it lets pass; what we refuse."""

import pytest

from pqsec_pki.errors import VerificationError
from tests.interop.fastdds_meeting import ECDH, MODP, refused

pytestmark = pytest.mark.interop

ECDSA, RSA = "ECDSA-SHA256", "RSASSA-PSS-SHA256"


def flipped(name):
    """A change of one bit in that property: the last, or one that counts."""

    def change(message):
        value = bytearray(dict(message.binary)[name])
        value[5 if name in {"c.id", "c.pdata"} else -1] ^= 1
        binary = tuple(
            (each, bytes(value) if each == name else old) for each, old in message.binary
        )
        return message._replace(binary=binary)

    return change


def without(name):
    """A change that drops that property."""
    return lambda message: message._replace(
        binary=tuple(pair for pair in message.binary if pair[0] != name)
    )


REQUEST_FIELDS = {
    "c.id": "Cannot load certificate",
    "c.pdata": "Bad participant_key's 47bits in c.pdata",
    "c.dsign_algo": "Not supported signature algorithm",
    "c.kagree_algo": "Not supported key agreement algorithm",
    "dh1": "Cannot store peer key from dh1",
}
REPLY_FIELDS = {
    "c.id": "Cannot load certificate",
    "c.perm": "Wrong hash_c2",
    "c.pdata": "Bad participant_key's 47bits in c.pdata",
    "c.dsign_algo": "Not supported signature algorithm",
    "c.kagree_algo": "Invalid key agreement algorithm",
    "hash_c1": "Invalid property hash_c1",
    "hash_c2": "Wrong hash_c2",
    "dh1": "Invalid property dh1",
    "dh2": "Signature verification error",
    "challenge1": "Invalid property challenge1",
    "challenge2": "Signature verification error",
    "signature": "Signature verification error",
}
FINAL_FIELDS = {
    "challenge1": "Invalid challenge1",
    "challenge2": "Invalid challenge2",
    "signature": "Signature verification error",
}
REPEATED = ("hash_c1", "hash_c2", "dh1", "dh2")


@pytest.mark.parametrize("field", REQUEST_FIELDS)
def test_fastdds_refuses_our_request_if_it_was_changed(meet_fastdds, now, field):
    with refused("begin_handshake_reply", REQUEST_FIELDS[field]):
        meet_fastdds(we="bob").we_begin(now, request=flipped(field))


@pytest.mark.parametrize("field", ["c.perm", "challenge1"])
def test_we_see_in_fastdds_reply_that_our_request_was_changed(meet_fastdds, now, field):
    with pytest.raises(VerificationError, match="is not as expected"):
        meet_fastdds(we="bob").we_begin(now, request=flipped(field))


def test_fastdds_sees_in_our_reply_that_its_request_was_changed(meet_fastdds, now):
    with refused("process_handshake", "Invalid property challenge1"):
        meet_fastdds(we="alice").fastdds_begins(now, request=flipped("challenge1"))


@pytest.mark.parametrize("field", REPLY_FIELDS)
def test_fastdds_refuses_our_reply_if_it_was_changed(meet_fastdds, now, field):
    with refused("process_handshake", REPLY_FIELDS[field]):
        meet_fastdds(we="alice").fastdds_begins(now, reply=flipped(field))


@pytest.mark.parametrize("field", FINAL_FIELDS)
def test_fastdds_refuses_our_final_if_it_was_changed(meet_fastdds, now, field):
    with refused("process_handshake", FINAL_FIELDS[field]):
        meet_fastdds(we="bob").we_begin(now, final=flipped(field))


@pytest.mark.parametrize("field", [*REQUEST_FIELDS, "c.perm", "hash_c1"])
def test_we_refuse_fastdds_request_if_it_was_changed(meet_fastdds, now, field):
    with pytest.raises(VerificationError):
        meet_fastdds(we="alice").fastdds_begins(now, request=flipped(field))


@pytest.mark.parametrize("field", REPLY_FIELDS)
def test_we_refuse_fastdds_reply_if_it_was_changed(meet_fastdds, now, field):
    with pytest.raises(VerificationError):
        meet_fastdds(we="bob").we_begin(now, reply=flipped(field))


@pytest.mark.parametrize("field", [*FINAL_FIELDS, *REPEATED])
def test_we_refuse_fastdds_final_if_it_was_changed(meet_fastdds, now, field):
    with pytest.raises(VerificationError):
        meet_fastdds(we="alice").fastdds_begins(now, final=flipped(field))


@pytest.mark.parametrize("field", ["hash_c1", "hash_c2", "dh1"])
def test_fastdds_refuses_a_reply_without_what_is_optional(meet_fastdds, now, field):
    with refused("process_handshake", f"Cannot find property {field}"):
        meet_fastdds(we="alice").fastdds_begins(now, reply=without(field))


@pytest.mark.parametrize(
    ("message", "field"), [("request", "hash_c1"), *(("final", name) for name in REPEATED)]
)
def test_fastdds_minds_neither_lack_nor_flaw_of_what_else_is_optional(
    meet_fastdds, now, message, field
):
    for change in (without(field), flipped(field)):
        both = meet_fastdds(we="bob")
        both.agree(*both.we_begin(now, **{message: change}))


NAMES = {"signature_algorithm": ECDSA.encode(), "key_agreement": MODP.wire_name.encode()}


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("signature_algorithm", f"Not supported signature algorithm ({ECDSA}\0)"),
        ("key_agreement", "Invalid key agreement algorithm. Received DH+MODP-2048-256\0"),
    ],
)
def test_fastdds_refuses_a_reply_with_a_name_that_ends_in_nul(meet_fastdds, now, field, words):
    both = meet_fastdds(we="alice")
    both.agree(*both.saying(**NAMES).fastdds_begins(now))
    with refused("process_handshake", words):
        both.saying(**NAMES | {field: NAMES[field] + b"\0"}).fastdds_begins(now)


@pytest.mark.parametrize("end", ["", "\0"], ids=["plain", "NUL"])
def test_fastdds_takes_a_request_with_either_ending_and_mirrors_one(meet_fastdds, now, end):
    names = {"signature_algorithm": ECDSA + end, "key_agreement": ECDH.wire_name + end}
    both = meet_fastdds(we="bob")
    both = both.saying(**{name: value.encode() for name, value in names.items()})
    said = {}
    both.agree(*both.we_begin(now, reply=lambda reply: said.update(reply.binary) or reply))
    assert said["c.dsign_algo"].decode() == ECDSA
    assert said["c.kagree_algo"].decode() == ECDH.wire_name + end


def test_fastdds_does_not_compare_the_signature_algorithm_with_the_key(meet_fastdds, now):
    both = meet_fastdds(we="bob").saying(signature_algorithm=RSA.encode())
    both.agree(*both.we_begin(now))
