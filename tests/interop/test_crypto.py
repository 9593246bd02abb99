"""Keys and what they protect, both ways, with Cyclone DDS's own crypto plugin."""

import ctypes
import os
from dataclasses import replace
from itertools import product

import pytest

from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.handshake import (
    Done,
    KeyMaterial,
    MessageClass,
    Sender,
    TransformationKind,
    key_exchange_material,
    unprotect_submessage,
)
from tests.interop.cyclone_abi import RefusedError
from tests.interop.cyclone_crypto import Protection, crypto
from tests.interop.cyclone_types import SharedSecret
from tests.interop.exchange import KINDS, PAYLOAD, SUBMESSAGE, Exchange, data

pytestmark = pytest.mark.interop

PROTECTIONS = [Protection(*each) for each in product([True, False], [True, False], [256, 128])]
every_protection = pytest.mark.parametrize("protection", PROTECTIONS, ids=str)
of_256_bits = pytest.mark.parametrize("protection", PROTECTIONS[::2], ids=str)
either_kind = pytest.mark.parametrize("kind", KINDS)
ORIGIN = Protection(origin=True)
NOT_OURS = (MalformedError, VerificationError)


@pytest.fixture(scope="module")
def met(plugins):
    """Cyclone DDS's plugin and the end of a handshake on our side, with one secret."""
    secret, *challenges = (os.urandom(32) for _ in range(3))
    handle = SharedSecret.of(secret, *challenges)
    done = Done(
        peer=None,
        agreement=None,
        challenge1=challenges[0],
        challenge2=challenges[1],
        shared_secret=secret,
    )
    with crypto(plugins, ctypes.addressof(handle)) as theirs:
        yield theirs, done


@pytest.fixture(scope="module")
def exchange(met):
    return Exchange(*met)


@either_kind
def test_submessages_under_the_key_of_the_key_exchange_go_both_ways(met, kind):
    theirs, done = met
    material, volatile = key_exchange_material(done), theirs.volatile(kind)
    assert unprotect_submessage(material, volatile.protect(SUBMESSAGE)) == SUBMESSAGE
    assert volatile.unprotect(Sender(material).protect_submessage(SUBMESSAGE)) == SUBMESSAGE


def test_with_another_secret_nothing_is_read_on_either_side(met):
    theirs, done = met
    other = key_exchange_material(replace(done, shared_secret=os.urandom(32)))
    volatile = theirs.volatile("reader")
    with pytest.raises(VerificationError):
        unprotect_submessage(other, volatile.protect(SUBMESSAGE))
    with pytest.raises(RefusedError):
        volatile.unprotect(Sender(other).protect_submessage(SUBMESSAGE))


@pytest.mark.parametrize("rtps", [True, False], ids=["messages encrypted", "messages in the clear"])
def test_participants_send_each_other_their_keys(plugins, met, rtps):
    _, done = met
    handle = SharedSecret.of(done.shared_secret, done.challenge1, done.challenge2)
    with crypto(plugins, ctypes.addressof(handle), rtps=rtps) as theirs:
        got = Exchange(theirs, done).participants()
    assert got.kind is (TransformationKind.AES256_GCM if rtps else TransformationKind.NONE)
    assert not got.receiver_key


@every_protection
@either_kind
def test_submessages_go_both_ways(exchange, kind, protection):
    pair = exchange.endpoints(kind, protection)
    assert pair.theirs[0].kind == 2 * (protection.bits == 256) + 1 + protection.encrypts
    assert bool(pair.theirs[0].receiver_key) == protection.origin
    assert pair.unprotect(pair.cyclone.protect(SUBMESSAGE)) == SUBMESSAGE
    assert pair.cyclone.unprotect(pair.protect(SUBMESSAGE)) == SUBMESSAGE


@every_protection
def test_payloads_go_both_ways(exchange, protection):
    from_cyclone, to_cyclone = (exchange.endpoints(kind, protection) for kind in KINDS)
    sealed = from_cyclone.cyclone.protect_payload(PAYLOAD)
    assert from_cyclone.unprotect_payload(sealed) == PAYLOAD
    assert (PAYLOAD in sealed) != protection.encrypts
    assert to_cyclone.cyclone.unprotect_payload(to_cyclone.protect_payload(PAYLOAD)) == PAYLOAD


@pytest.mark.parametrize("size", [1, 2, 3, 5, 4096, 100_003])
def test_cyclone_reads_our_encrypted_payload_of_any_size(exchange, size):
    pair = exchange.endpoints("reader", Protection())
    payload = os.urandom(size)
    assert pair.cyclone.unprotect_payload(pair.protect_payload(payload)) == payload


def test_what_cyclone_counts_up_we_read_and_what_we_count_up_it_reads(exchange):
    pair = exchange.endpoints("reader", Protection())
    sender = Sender(pair.ours[0], blocks_per_session=5)
    for number in range(20):
        ours = data(number.to_bytes(4))
        assert pair.cyclone.unprotect(sender.protect_submessage(ours)) == ours
        assert pair.unprotect(pair.cyclone.protect(ours)) == ours


@pytest.mark.parametrize("encrypts", [True, False], ids=["encrypt", "sign"])
def test_each_of_cyclones_receivers_finds_its_own_tag(exchange, encrypts):
    protection = Protection(encrypts=encrypts, origin=True)
    one = exchange.endpoints("writer", protection)
    two = exchange.introduced(one.cyclone.another(), protection)
    for_both = one.cyclone.protect(SUBMESSAGE, two.cyclone)
    assert one.unprotect(for_both) == two.unprotect(for_both) == SUBMESSAGE
    with pytest.raises(VerificationError, match="no tag for this receiver"):
        two.unprotect(one.cyclone.protect(SUBMESSAGE))


@pytest.mark.parametrize("encrypts", [True, False], ids=["encrypt", "sign"])
def test_each_of_our_receivers_in_cyclone_finds_its_own_tag(exchange, encrypts):
    protection = Protection(encrypts=encrypts, origin=True)
    one = exchange.endpoints("reader", protection)
    two = exchange.endpoints("reader", protection, like=one)
    # Cyclone DDS looks at the first tag that is for any of its readers, so each comes first once.
    for for_both in (one.protect(SUBMESSAGE, two), two.protect(SUBMESSAGE, one)):
        assert one.cyclone.unprotect(for_both) == two.cyclone.unprotect(for_both) == SUBMESSAGE


@either_kind
def test_without_its_tag_cyclone_refuses(exchange, kind):
    pair = exchange.endpoints(kind, ORIGIN)
    sender = Sender(pair.ours[0])
    for receivers in ([], [pair.ours[0].for_receiver()]):
        with pytest.raises(RefusedError, match="receiver specific"):
            pair.cyclone.unprotect(sender.protect_submessage(SUBMESSAGE, receivers=receivers))


@either_kind
def test_a_receiver_that_plays_the_sender_is_refused_on_either_side(exchange, kind):
    # It has the sender's key, and not the key of another receiver.
    pair = exchange.endpoints(kind, ORIGIN)
    forged = [replace(each, receiver_key=os.urandom(32)) for each in (pair.ours[0], pair.theirs[0])]
    to_cyclone, to_us = (
        Sender(each).protect_submessage(SUBMESSAGE, receivers=[each]) for each in forged
    )
    with pytest.raises(RefusedError, match="receiver specific"):
        pair.cyclone.unprotect(to_cyclone)
    with pytest.raises(VerificationError, match="no tag for this receiver"):
        pair.unprotect(to_us)


@of_256_bits
def test_signed_where_encryption_is_due_and_the_reverse_are_refused_on_either_side(
    exchange, protection
):
    pair = exchange.endpoints("reader", protection)
    other = {3: TransformationKind.AES256_GCM, 4: TransformationKind.AES256_GMAC}
    own = replace(pair.ours[0], kind=other[pair.ours[0].kind])
    receivers = [own] if protection.origin else []
    sealed = Sender(own).protect_submessage(SUBMESSAGE, receivers=receivers)
    with pytest.raises(RefusedError, match="unexpected"):
        pair.cyclone.unprotect(sealed)
    with pytest.raises(VerificationError, match="another way"):
        unprotect_submessage(pair.ours[0], sealed)


def flips(sealed):
    """Each bit's place, and `sealed` with that bit changed."""
    for place in range(len(sealed) * 8):
        changed = bytearray(sealed)
        changed[place // 8] ^= 1 << place % 8
        yield place, bytes(changed)


def accepted(sealed, read, refusal):
    """The places of bits that `read` does not care about."""
    found = set()
    for place, changed in flips(sealed):
        try:
            read(changed)
        except refusal:
            continue
        found.add(place)
    return found


KEY_SIZE_BIT = 3 * 8 + 1
"""In a crypto header, what tells 1 (AES128_GMAC) from 3 (AES256_GMAC).

Cyclone DDS goes by the key that it has. 4 (AES256_GCM) has no such neighbour.
"""


@pytest.mark.slow(but=2)
@of_256_bits
def test_cyclone_and_we_refuse_the_same_changed_bits_of_a_submessage(exchange, protection):
    pair = exchange.endpoints("reader", protection)
    sealed = pair.protect(SUBMESSAGE)
    theirs = accepted(sealed, pair.cyclone.unprotect, RefusedError)
    ours = accepted(sealed, lambda each: unprotect_submessage(pair.ours[0], each), NOT_OURS)
    assert theirs - ours == ({4 * 8 + KEY_SIZE_BIT} if not protection.encrypts else set())
    # The rest are flags of the three submessages around the content, which say nothing here.
    starts = [0, 24, len(sealed) - 24 - 20 * protection.origin]
    flags = starts if protection.encrypts else [0, starts[2]]
    assert ours == theirs & ours == {start * 8 + 8 + bit for start in flags for bit in range(1, 8)}


@of_256_bits
def test_cyclone_and_we_refuse_the_same_changed_bits_of_a_payload(exchange, protection):
    pair = exchange.endpoints("reader", protection)
    sealed = pair.protect_payload(PAYLOAD)
    theirs = accepted(sealed, pair.cyclone.unprotect_payload, RefusedError)
    assert theirs == ({KEY_SIZE_BIT} if not protection.encrypts else set())
    own = replace(pair, theirs=pair.ours)
    assert accepted(sealed, own.unprotect_payload, NOT_OURS) == set()


def test_cyclone_refuses_keys_of_no_kind_where_messages_are_protected(exchange, met):
    none = KeyMaterial.generate(TransformationKind.NONE)
    with pytest.raises(RefusedError, match="Crypto token"):
        met[0].take(exchange.send(MessageClass.PARTICIPANT_CRYPTO_TOKENS, [none]))
