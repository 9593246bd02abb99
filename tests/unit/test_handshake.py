"""Three messages between two participants; and every way we know to spoil them."""

import os
from dataclasses import replace
from datetime import timedelta
from functools import cache
from itertools import product

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, Family, pair_private
from pqsec_pki.certificates import Authority
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    AuthRequest,
    DataHolder,
    Discovered,
    Final,
    GenericMessage,
    Identity,
    KeyMaterial,
    MessageClass,
    PeerRequirements,
    Reply,
    Request,
    Sender,
    Terms,
    Transcript,
    TransformationKind,
    adjusted_guid,
    begin,
    confirmation,
    confirmed,
    key_exchange_material,
    participant_data,
    reply_to,
    token_message,
    unprotect_submessage,
)
from pqsec_pki.problems import Code

DAY = timedelta(days=1)
ENTITY = b"\0\0\1\xc1"
ECDH = KEY_AGREEMENTS.named("ecdh-p256")
MODP = KEY_AGREEMENTS.named("dh-modp-2048-256")
HYBRID = KEY_AGREEMENTS.named("x25519mlkem768")
_VOLATILE_WRITER = b"\xff\x02\x02\xc3"
"""The entity ID of ParticipantVolatileMessageSecureWriter (DDS-Security 1.1, 7.3.7.1)."""
EVERYTHING = PeerRequirements(agreements=tuple(KEY_AGREEMENTS))
OPTIONAL = {"dh1", "dh2", "hash_c1", "hash_c2"}
KINDS = ("ecdsa-p256", "rsa-2048", "ml-dsa-65", "mldsa65+p256", ("ecdsa-p256", "ml-dsa-65"))


def rows(kind):
    """(row, alternative row) for "name" or ("name", "alternative")."""
    names = (kind, None) if isinstance(kind, str) else kind
    return [SIGNATURES.named(name) if name else None for name in names]


@cache
def authority(kind, now, label="ours"):
    del label  # authorities of one name, but with different keys
    row, alternative = rows(kind)
    return Authority.create(
        "Identity CA", row, alternative=alternative, now=now, validity=900 * DAY
    )


@cache
def keys(kind, name, label="ours"):
    """The key of CN=`name`, and its alternative key or None."""
    del name, label
    return [row.generate() if row else None for row in rows(kind)]


@cache
def enrolled(kind, name, now, label="ours"):
    """The identity of CN=`name`, issued at `now` for 30 days."""
    key, second = keys(kind, name, label)
    ca = authority(kind, now, label)
    certificate = ca.issue(
        name, key.public_key, alternative=second and second.public_key, now=now, validity=30 * DAY
    )
    return Identity(
        certificate=certificate,
        key=pair_private(key, second) if second else key,
        ca=ca.certificate,
        guid=adjusted_guid(certificate.subject_der, name.encode().ljust(12) + ENTITY),
        permissions=b"permissions of " + name.encode(),
    )


class Meeting:
    """Alice, who initiates, and Bob. Each method is one step, on fresh state."""

    def __init__(self, now, kind="ecdsa-p256", agreement=ECDH, policy=EVERYTHING):
        self.now, self.agreement = now, agreement
        self.alice, self.bob = (enrolled(kind, name, now) for name in ("alice", "bob"))
        self.of_alice = Terms(
            own=self.alice, policy=policy, discovered=Discovered(guid=self.bob.guid)
        )
        self.of_bob = Terms(
            own=self.bob, policy=policy, discovered=Discovered(guid=self.alice.guid)
        )

    def request(self):
        return begin(self.of_alice, self.agreement)

    def reply(self, request):
        return reply_to(self.of_bob, request, now=self.now)

    def run(self):
        """Both ends, after messages that went through their holders."""
        request, waiting = self.request()
        reply, awaiting = self.reply(Request.from_holder(request.to_holder()))
        final, one = waiting.receive(Reply.from_holder(reply.to_holder()), now=self.now)
        return one, awaiting.receive(Final.from_holder(final.to_holder()))


@pytest.fixture
def meeting(now):
    return Meeting(now)


def changed(message, name, change):
    """`message` with one property changed, by its name on the wire."""
    holder = message.to_holder()
    items = [
        (key, change(value) if key == name else value) for key, value in holder.binary_properties
    ]
    return type(message).from_holder(DataHolder(holder.class_id, (), tuple(items)))


def without(message, *names):
    """`message` read again without some of its properties."""
    holder = message.to_holder()
    items = [item for item in holder.binary_properties if item[0] not in names]
    return type(message).from_holder(DataHolder(holder.class_id, (), tuple(items)))


def flipped(value):
    middle = len(value) // 2
    return value[:middle] + bytes([value[middle] ^ 1]) + value[middle + 1 :]


# It works


@pytest.mark.parametrize("agreement", list(KEY_AGREEMENTS), ids=lambda row: row.name)
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_two_participants_agree_and_can_talk(now, kind, agreement):
    one, other = Meeting(now, kind, agreement).run()
    assert one.shared_secret == other.shared_secret
    assert len(one.shared_secret) == 32
    sealed = Sender(key_exchange_material(one)).protect_submessage(b"to bob..")
    assert unprotect_submessage(key_exchange_material(other), sealed) == b"to bob.."


def first_keys(sender, done):
    """Its first message, and the keys in it."""
    keys = KeyMaterial.generate(TransformationKind.AES256_GCM)
    return confirmation(sender.guid, done, keys), keys


@pytest.mark.parametrize("agreement", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_the_first_protected_message_confirms_each_to_the_other(now, agreement):
    meeting = Meeting(now, agreement=agreement)
    one, other = meeting.run()
    sealed, keys = first_keys(meeting.alice, one)
    assert confirmed(meeting.bob.guid, other, sealed) == keys
    sealed, keys = first_keys(meeting.bob, other)
    assert confirmed(meeting.alice.guid, one, sealed) == keys


@pytest.mark.parametrize("agreement", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_ones_own_first_message_sent_back_confirms_nobody(now, agreement):
    meeting = Meeting(now, agreement=agreement)
    for side, done in zip((meeting.alice, meeting.bob), meeting.run(), strict=True):
        sealed, _ = first_keys(side, done)
        assert unprotect_submessage(key_exchange_material(done), sealed)  # one key both ways
        with pytest.raises(VerificationError, match="is for another participant"):
            confirmed(side.guid, done, sealed)


def test_a_first_message_from_another_than_the_peer_confirms_nobody(meeting):
    one, other = meeting.run()
    mallory = enrolled("ecdsa-p256", "mallory", meeting.now)
    sealed, _ = first_keys(mallory, one)
    with pytest.raises(VerificationError, match="not from the peer"):
        confirmed(meeting.bob.guid, other, sealed)


@pytest.mark.parametrize("octet", range(16))
def test_a_first_message_of_a_guid_that_differs_in_one_octet_confirms_nobody(meeting, octet):
    """GUIDs of two participants may begin alike; the last four octets of the source are fixed."""
    one, other = meeting.run()
    keys = KeyMaterial.generate(TransformationKind.AES256_GCM)
    sender, own = Sender(key_exchange_material(one)), meeting.bob.guid
    near = [bytearray(each) for each in (meeting.alice.guid, own)]
    for each in near:
        each[octet] ^= 1
    for_another = token_message(meeting.alice.guid, bytes(near[1]), keys)
    with pytest.raises(VerificationError, match="is for another participant"):
        confirmed(own, other, sender.protect_submessage(for_another))
    if octet < 12:
        of_another = token_message(bytes(near[0]), own, keys)
        with pytest.raises(VerificationError, match="not from the peer"):
            confirmed(own, other, sender.protect_submessage(of_another))


def test_what_is_no_first_message_confirms_nobody(meeting):
    one, other = meeting.run()
    keys = KeyMaterial.generate(TransformationKind.AES256_GCM)
    good = token_message(meeting.alice.guid, meeting.bob.guid, keys)
    sender = Sender(key_exchange_material(one))
    for at in (0, 1, 2, 6, 8, 12):
        wrong = bytearray(good)
        wrong[at] ^= 1
        with pytest.raises(VerificationError, match="not of the volatile secure topic"):
            confirmed(meeting.bob.guid, other, sender.protect_submessage(bytes(wrong)))
    for size in (0, 4, 20):
        with pytest.raises(VerificationError, match="a first protected message of"):
            confirmed(meeting.bob.guid, other, sender.protect_submessage(good[:size]))
    assert confirmed(meeting.bob.guid, other, sender.protect_submessage(good)) == keys


@pytest.mark.parametrize(
    ("class_id", "count"),
    [
        (MessageClass.HANDSHAKE, 1),
        (MessageClass.PARTICIPANT_CRYPTO_TOKENS, 0),
        (MessageClass.PARTICIPANT_CRYPTO_TOKENS, 2),
    ],
)
def test_a_first_message_with_anything_else_than_one_key_confirms_nobody(meeting, class_id, count):
    one, other = meeting.run()
    keys = KeyMaterial.generate(TransformationKind.AES256_GCM)
    good = token_message(meeting.alice.guid, meeting.bob.guid, keys)
    sample = GenericMessage(
        source=meeting.alice.guid[:12] + _VOLATILE_WRITER,
        sequence=1,
        destination_participant=meeting.bob.guid,
        class_id=class_id,
        tokens=(keys.to_holder(),) * count,
    ).encode()
    head = bytearray(good[:24])
    head[2:4] = (20 + len(sample)).to_bytes(2, "little")  # octetsToNextHeader
    sealed = Sender(key_exchange_material(one)).protect_submessage(bytes(head) + sample)
    with pytest.raises(VerificationError, match="with one token"):
        confirmed(meeting.bob.guid, other, sealed)


def test_each_learns_who_the_other_is_and_what_it_may(meeting):
    one, other = meeting.run()
    assert one.peer.certificate.der == meeting.bob.certificate.der
    assert other.peer.certificate.der == meeting.alice.certificate.der
    assert one.peer.permissions == b"permissions of bob"
    assert other.peer.permissions == b"permissions of alice"
    assert (one.peer.guid, other.peer.guid) == (meeting.bob.guid, meeting.alice.guid)
    assert (one.challenge1, one.challenge2) == (other.challenge1, other.challenge2)
    assert one.agreement is other.agreement is ECDH


@pytest.mark.parametrize("agreement", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_handshakes_of_one_participant_at_the_same_time_keep_apart(now, agreement):
    meeting = Meeting(now, agreement=agreement)
    requests, waiting = zip(*(meeting.request() for _ in range(2)), strict=True)
    replies, awaiting = zip(*map(meeting.reply, requests), strict=True)
    ends = []
    for at in (1, 0):  # the second ends first
        final, one = waiting[at].receive(replies[at], now=now)
        ends.append((one.shared_secret, awaiting[at].receive(final).shared_secret))
    assert all(one == other for one, other in ends)
    assert ends[0] != ends[1]


def test_two_handshakes_have_nothing_in_common(meeting):
    (one, _), (two, _) = meeting.run(), meeting.run()
    assert one.shared_secret != two.shared_secret
    assert one.challenge1 != two.challenge1
    assert one.challenge2 != two.challenge2


def test_no_state_prints_the_secret(meeting):
    request, waiting = meeting.request()
    reply, awaiting = meeting.reply(request)
    _, done = waiting.receive(reply, now=meeting.now)
    for value in (waiting, awaiting, done):
        assert "shared_secret" not in repr(value)
        assert "handle" not in repr(value)
        assert repr(done.shared_secret)[2:-1] not in repr(value)


def test_messages_carry_all_optional_properties_in_the_order_of_the_specification(meeting):
    # Fast DDS refuses a Reply without hash_c1, hash_c2 or dh1.
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    final, _ = waiting.receive(reply, now=meeting.now)
    own = ["c.id", "c.perm", "c.pdata", "c.dsign_algo", "c.kagree_algo"]
    names = [[name for name, _ in m.to_holder().binary_properties] for m in (request, reply, final)]
    assert names == [
        [*own, "hash_c1", "dh1", "challenge1"],
        [*own, "dh2", "challenge1", "challenge2", "dh1", "hash_c2", "hash_c1", "signature"],
        ["challenge1", "challenge2", "dh1", "dh2", "hash_c2", "hash_c1", "signature"],
    ]


def test_stock_peers_that_leave_out_optional_properties_are_understood(meeting):
    request, waiting = meeting.request()
    reply, awaiting = meeting.reply(without(request, *OPTIONAL - {"dh1"}))
    final, one = waiting.receive(without(reply, *OPTIONAL - {"dh2"}), now=meeting.now)
    other = awaiting.receive(without(final, *OPTIONAL))
    assert one.shared_secret == other.shared_secret


def test_names_end_in_nul_when_we_initiate(meeting):
    request, _ = meeting.request()
    assert request.introduction.signature_algorithm == b"ECDSA-SHA256\0"
    assert request.introduction.key_agreement == b"ECDH+prime256v1-CEUM\0"


def test_names_end_as_the_peers_do_when_we_reply(meeting):
    request, _ = meeting.request()
    said = request.introduction
    bare = replace(said, key_agreement=said.key_agreement[:-1])
    for introduction, end in ((said, b"\0"), (bare, b"")):
        reply, _ = meeting.reply(replace(request, introduction=introduction, hash_c1=None))
        assert reply.introduction.signature_algorithm == b"ECDSA-SHA256" + end
        assert reply.introduction.key_agreement == b"ECDH+prime256v1-CEUM" + end


def test_a_reply_without_nul_is_understood_though_we_sent_one(now):
    # Fast DDS answers so.
    meeting = Meeting(now)
    request, waiting = meeting.request()
    said = request.introduction
    bare = replace(
        request,
        introduction=replace(said, key_agreement=said.key_agreement[:-1]),
        hash_c1=None,
    )
    reply, _ = meeting.reply(bare)
    transcript = Transcript(
        hash_c1=waiting.hash_c1,
        hash_c2=reply.hash_c2,
        challenge1=reply.challenge1,
        challenge2=reply.challenge2,
        dh1=reply.dh1,
        dh2=reply.dh2,
    )
    signature = meeting.bob.key.sign_handshake(transcript.reply_octets())
    signed = replace(reply, hash_c1=waiting.hash_c1, signature=signature)
    assert waiting.receive(signed, now=now)[1].peer.guid == meeting.bob.guid


def test_certificate_and_permissions_may_end_in_nul(now):
    # OpenDDS sends them so.
    meeting = Meeting(now)
    request, _ = meeting.request()
    said = request.introduction
    introduction = replace(
        said, certificate=said.certificate + b"\0", permissions=said.permissions + b"\0"
    )
    _, awaiting = meeting.reply(replace(request, introduction=introduction, hash_c1=None))
    assert awaiting._outcome.peer.permissions == b"permissions of alice"


def test_an_announced_challenge_is_used_by_both_sides(now):
    meeting = Meeting(now)
    alices, bobs = os.urandom(32), os.urandom(32)
    meeting.of_alice = replace(
        meeting.of_alice, announced=alices, discovered=Discovered(future_challenge=bobs)
    )
    meeting.of_bob = replace(
        meeting.of_bob, announced=bobs, discovered=Discovered(future_challenge=alices)
    )
    one, _ = meeting.run()
    assert (one.challenge1, one.challenge2) == (alices, bobs)


def test_an_auth_request_comes_back_as_it_went():
    message = AuthRequest(future_challenge=bytes(range(32)))
    assert AuthRequest.from_holder(message.to_holder()) == message


# Messages that cannot be read


@pytest.mark.parametrize("kind", [Request, Reply, Final])
def test_a_message_of_another_class_is_refused(meeting, kind):
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    final, _ = waiting.receive(reply, now=meeting.now)
    for message in (request, reply, final):
        if type(message) is not kind:
            with pytest.raises(VerificationError, match="expected a"):
                kind.from_holder(message.to_holder())


def test_a_class_id_that_only_begins_right_is_refused(meeting):
    # Cyclone DDS compares a prefix.
    holder = meeting.request()[0].to_holder()
    longer = DataHolder(holder.class_id + "uest", (), holder.binary_properties)
    with pytest.raises(VerificationError, match="expected a"):
        Request.from_holder(longer)


def test_a_property_that_is_there_twice_is_refused(meeting):
    # Cyclone DDS takes the first, others may take the last.
    holder = meeting.request()[0].to_holder()
    for item in holder.binary_properties:
        twice = DataHolder(holder.class_id, (), (*holder.binary_properties, item))
        with pytest.raises(VerificationError, match="2 times") as refusal:
            Request.from_holder(twice)
        assert [each.code for each in refusal.value.problems] == [Code.C5]


def test_an_unknown_property_is_ignored_but_not_one_that_hashes_may_cover(meeting):
    request, _ = meeting.request()
    holder = request.to_holder()
    more = DataHolder(holder.class_id, (), (*holder.binary_properties, ("x.vendor", b"1")))
    assert Request.from_holder(more) == request
    covered = DataHolder(holder.class_id, (), (*holder.binary_properties, ("c.vendor", b"1")))
    with pytest.raises(VerificationError, match=r"c\.vendor"):
        Request.from_holder(covered)


def test_properties_are_found_by_name_in_any_order(meeting):
    request, _ = meeting.request()
    holder = request.to_holder()
    backwards = DataHolder(holder.class_id, (), holder.binary_properties[::-1])
    assert Request.from_holder(backwards) == request


def test_everything_that_is_missing_is_listed(meeting):
    with pytest.raises(VerificationError) as caught:
        Reply.from_holder(DataHolder("DDS:Auth:PKI-DH:1.0+Reply"))
    missing = {problem.removesuffix(" is missing") for problem in caught.value.lines}
    reply, _ = meeting.reply(meeting.request()[0])
    names = {name for name, _ in reply.to_holder().binary_properties}
    assert missing == names - (OPTIONAL - {"dh2"})


@pytest.mark.parametrize("size", [0, 31, 33])
@pytest.mark.parametrize("name", ["challenge1", "challenge2", "hash_c1", "hash_c2"])
def test_a_hash_or_challenge_of_a_wrong_size_is_refused(meeting, name, size):
    reply, _ = meeting.reply(meeting.request()[0])
    with pytest.raises(VerificationError, match=f"{name} has {size} bytes"):
        changed(reply, name, lambda _: bytes(size))


# Messages that were changed on the way

SUITES = [("ecdsa-p256", ECDH), ("ml-dsa-65", HYBRID), (("ecdsa-p256", "ml-dsa-65"), HYBRID)]
suites = pytest.mark.parametrize(("kind", "agreement"), SUITES, ids=str)
IN_REQUEST = ("c.id", "c.perm", "c.pdata", "c.dsign_algo", "c.kagree_algo", "hash_c1")
IN_REPLY = (
    *IN_REQUEST,
    "dh2",
    "challenge1",
    "challenge2",
    "dh1",
    "hash_c2",
    "signature",
)
IN_FINAL = ("challenge1", "challenge2", "dh1", "dh2", "hash_c2", "hash_c1", "signature")


@suites
@pytest.mark.parametrize("name", IN_REQUEST)
def test_a_changed_request_is_refused(now, kind, agreement, name):
    meeting = Meeting(now, kind, agreement)
    request, _ = meeting.request()
    with pytest.raises(VerificationError):
        meeting.reply(changed(request, name, flipped))


@suites
@pytest.mark.parametrize("name", ["dh1", "challenge1"])
def test_a_request_changed_where_nothing_shows_it_yet_fails_at_its_reply(
    now, kind, agreement, name
):
    meeting = Meeting(now, kind, agreement)
    request, waiting = meeting.request()
    other = begin(meeting.of_alice, agreement)[0].to_holder().binary_properties
    reply, _ = meeting.reply(changed(request, name, lambda _: dict(other)[name]))
    with pytest.raises(VerificationError, match=f"{name} is not as expected"):
        waiting.receive(reply, now=now)


@suites
@pytest.mark.parametrize("name", IN_REPLY)
def test_a_changed_reply_is_refused(now, kind, agreement, name):
    meeting = Meeting(now, kind, agreement)
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    with pytest.raises(VerificationError):
        waiting.receive(changed(reply, name, flipped), now=now)


@suites
@pytest.mark.parametrize("name", IN_FINAL)
def test_a_changed_final_is_refused(now, kind, agreement, name):
    meeting = Meeting(now, kind, agreement)
    request, waiting = meeting.request()
    reply, awaiting = meeting.reply(request)
    final, _ = waiting.receive(reply, now=now)
    with pytest.raises(VerificationError):
        awaiting.receive(changed(final, name, flipped))


@pytest.mark.parametrize(
    ("name", "strip"), [*product(IN_REPLY[:5], [True, False]), ("dh2", True), ("challenge2", True)]
)
def test_a_reply_is_refused_by_its_signature_even_if_what_it_repeats_is_stripped(
    meeting, name, strip
):
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    reply = without(reply, "hash_c1", "hash_c2", "dh1") if strip else reply
    with pytest.raises(VerificationError):
        waiting.receive(changed(reply, name, flipped), now=meeting.now)


@pytest.mark.parametrize("name", ["c.perm", "dh1"])
def test_a_man_in_the_middle_who_strips_the_hashes_too_is_found_out(meeting, name):
    request, waiting = meeting.request()
    stranger, _ = begin(meeting.of_alice, ECDH)
    value = {"c.perm": b"permissions of mallory", "dh1": stranger.dh1}[name]
    reply, _ = meeting.reply(changed(without(request, "hash_c1"), name, lambda _: value))
    with pytest.raises(VerificationError, match="signature"):
        waiting.receive(without(reply, "hash_c1", "dh1"), now=meeting.now)


def test_all_that_is_wrong_with_a_reply_is_listed(meeting):
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    for name in ("hash_c1", "hash_c2", "dh1", "c.kagree_algo", "c.dsign_algo"):
        reply = changed(reply, name, flipped)
    with pytest.raises(VerificationError) as caught:
        waiting.receive(reply, now=meeting.now + 90 * DAY)
    text = "; ".join(caught.value.lines)
    for word in ("expired", "kagree", "dsign", "hash_c1", "hash_c2", "dh1"):
        assert word in text


# Messages that are another's, or of another time


def test_the_reply_of_another_session_is_refused(meeting):
    reply, _ = meeting.reply(meeting.request()[0])
    _, waiting = meeting.request()
    with pytest.raises(VerificationError, match="challenge1 is not as expected"):
        waiting.receive(reply, now=meeting.now)


def test_the_final_of_another_session_is_refused(meeting):
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    final, _ = waiting.receive(reply, now=meeting.now)
    _, awaiting = meeting.reply(meeting.request()[0])
    with pytest.raises(VerificationError, match="challenge1 is not as expected"):
        awaiting.receive(final)


def test_a_state_shares_its_peers_permissions_and_no_others(meeting):
    _, awaiting = meeting.reply(meeting.request()[0])
    same = bytes(bytearray(awaiting.peer.permissions))

    assert awaiting.sharing(same).peer.permissions is same
    with pytest.raises(ValueError, match="not the peer's"):
        awaiting.sharing(same + b"x")


def test_a_replayed_request_gets_no_further_than_its_reply(meeting):
    request, waiting = meeting.request()
    first, _ = meeting.reply(request)
    final, _ = waiting.receive(first, now=meeting.now)
    _, awaiting = meeting.reply(request)
    with pytest.raises(VerificationError, match="challenge2 is not as expected"):
        awaiting.receive(final)


@pytest.mark.parametrize("agreement", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_a_final_is_good_for_one_reply_though_two_have_one_announced_challenge(now, agreement):
    """Each Reply has a fresh dh2, and the Final's signature covers it (wire.md, 9)."""
    meeting = Meeting(now, agreement=agreement)
    meeting.of_bob = replace(meeting.of_bob, announced=os.urandom(32))
    request, waiting = meeting.request()
    first, awaiting_first = meeting.reply(request)
    second, awaiting_second = meeting.reply(request)
    assert first.challenge2 == second.challenge2
    assert first.dh2 != second.dh2
    final, one = waiting.receive(first, now=now)
    with pytest.raises(VerificationError, match="dh2 is not as expected"):
        awaiting_second.receive(final)
    with pytest.raises(VerificationError, match="signature"):
        awaiting_second.receive(without(final, *OPTIONAL))
    assert awaiting_first.receive(without(final, *OPTIONAL)).shared_secret == one.shared_secret


def test_a_challenge_other_than_the_announced_one_is_refused(meeting):
    expecting = Discovered(future_challenge=bytes(32))
    request, _ = meeting.request()
    with pytest.raises(VerificationError, match="challenge1 is not the one"):
        reply_to(replace(meeting.of_bob, discovered=expecting), request, now=meeting.now)
    request, waiting = begin(replace(meeting.of_alice, discovered=expecting), ECDH)
    reply, _ = meeting.reply(request)
    with pytest.raises(VerificationError, match="challenge2 is not the one"):
        waiting.receive(reply, now=meeting.now)


def test_a_request_that_is_reflected_to_its_sender_is_refused(now):
    meeting = Meeting(now)
    request, _ = meeting.request()
    with pytest.raises(VerificationError, match="our own"):
        reply_to(Terms(own=meeting.alice, policy=EVERYTHING), request, now=now)


def test_another_participant_of_the_right_ca_is_not_the_discovered_one(now):
    meeting = Meeting(now)
    mallory = enrolled("ecdsa-p256", "mallory", now)
    request, waiting = meeting.request()
    reply, _ = reply_to(Terms(own=mallory, policy=EVERYTHING), request, now=now)
    with pytest.raises(VerificationError, match="not the one that was discovered"):
        waiting.receive(reply, now=now)


def test_a_guid_that_belongs_to_another_subject_is_refused(now):
    meeting = Meeting(now)
    thief = replace(enrolled("ecdsa-p256", "mallory", now), guid=meeting.alice.guid)
    request, _ = begin(Terms(own=thief, policy=EVERYTHING), ECDH)
    with pytest.raises(VerificationError, match="does not belong"):
        meeting.reply(request)


def test_a_signature_by_a_key_that_is_not_the_certificates_is_refused(now):
    # What the plugin of the paper lets pass: anybody who holds a copy of the certificate.
    meeting = Meeting(now, "ml-dsa-65", HYBRID)
    thief = replace(meeting.bob, key=SIGNATURES.named("ml-dsa-65").generate())
    request, waiting = meeting.request()
    reply, _ = reply_to(replace(meeting.of_bob, own=thief), request, now=now)
    with pytest.raises(VerificationError, match="signature"):
        waiting.receive(reply, now=now)


@pytest.mark.parametrize("broken", ["alternative", "plain"])
def test_a_pair_of_keys_needs_both_signatures(now, broken):
    kind = ("ecdsa-p256", "ml-dsa-65")
    meeting = Meeting(now, kind, HYBRID)
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    size = SIGNATURES.named("ml-dsa-65").signature_size
    at = 0 if broken == "alternative" else size + 20
    spoilt = changed(
        reply, "signature", lambda value: value[:at] + bytes([value[at] ^ 1]) + value[at + 1 :]
    )
    with pytest.raises(VerificationError, match="signature"):
        waiting.receive(spoilt, now=now)


# Certificates that are not good enough


def test_an_expired_certificate_is_refused(now):
    meeting = Meeting(now)
    request, _ = meeting.request()
    with pytest.raises(VerificationError, match="expired"):
        reply_to(meeting.of_bob, request, now=now + 31 * DAY)


def test_a_certificate_that_is_not_yet_valid_is_refused(now):
    meeting = Meeting(now)
    request, _ = meeting.request()
    with pytest.raises(VerificationError, match="not valid before"):
        reply_to(meeting.of_bob, request, now=now - 2 * DAY)


def test_another_ca_of_the_same_name_is_refused(now):
    meeting = Meeting(now)
    stranger = enrolled("ecdsa-p256", "alice", now, "theirs")
    request, _ = begin(Terms(own=stranger, policy=EVERYTHING), ECDH)
    with pytest.raises(VerificationError, match="not signed by this CA"):
        meeting.reply(request)


def test_a_self_signed_certificate_is_refused(now):
    meeting = Meeting(now)
    own = Authority.create("alice", SIGNATURES.named("ecdsa-p256"), now=now, validity=DAY)
    guid = adjusted_guid(own.certificate.subject_der, bytes(12) + ENTITY)
    alone = replace(meeting.alice, certificate=own.certificate, key=own.key, guid=guid)
    request, _ = begin(Terms(own=alone, policy=EVERYTHING), ECDH)
    with pytest.raises(VerificationError, match="issued by CN=alice"):
        reply_to(Terms(own=meeting.bob, policy=EVERYTHING), request, now=now)


@pytest.mark.parametrize(
    "certificate",
    [b"", b"\0", b"not PEM", b"-----BEGIN CERTIFICATE-----\nMAA=\n-----END CERTIFICATE-----\n"],
)
def test_what_is_no_certificate_is_refused(meeting, certificate):
    request, _ = meeting.request()
    introduction = replace(request.introduction, certificate=certificate)
    with pytest.raises(VerificationError, match="introduction"):
        meeting.reply(replace(request, introduction=introduction, hash_c1=None))


def test_a_signature_algorithm_that_is_not_the_certificates_is_refused(meeting):
    # Cyclone DDS takes it, if hash_c1 is left out.
    request, _ = meeting.request()
    introduction = replace(request.introduction, signature_algorithm=b"RSASSA-PSS-SHA256\0")
    with pytest.raises(VerificationError, match=r"c\.dsign_algo 'RSASSA-PSS-SHA256'"):
        meeting.reply(replace(request, introduction=introduction, hash_c1=None))


def test_broken_participant_data_is_refused(meeting):
    request, _ = meeting.request()
    introduction = replace(request.introduction, participant_data=b"\0\x50\0\x10")
    with pytest.raises(VerificationError, match=r"c\.pdata"):
        meeting.reply(replace(request, introduction=introduction, hash_c1=None))


def test_participant_data_with_another_guid_of_the_same_subject_is_not_the_discovered_one(meeting):
    request, _ = meeting.request()
    other = participant_data(meeting.alice.guid[:6] + bytes(10))
    introduction = replace(request.introduction, participant_data=other)
    with pytest.raises(VerificationError, match="not the one that was discovered"):
        meeting.reply(replace(request, introduction=introduction, hash_c1=None))


# Downgrades


def test_a_request_for_an_agreement_that_is_not_allowed_is_refused(now):
    post_quantum = PeerRequirements(
        agreements=tuple(r for r in KEY_AGREEMENTS if r.family is not Family.CLASSICAL)
    )
    meeting = Meeting(now, "ml-dsa-65", ECDH, post_quantum)
    request, _ = meeting.request()
    with pytest.raises(VerificationError, match=r"'ECDH\+prime256v1-CEUM'.*X25519MLKEM768"):
        meeting.reply(request)


@pytest.mark.parametrize(
    "name", [b"", b"NONE", b"X25519MLKEM768\0\0", b"x25519mlkem768", b"\xff\xfe"]
)
def test_an_unknown_agreement_is_refused(meeting, name):
    # OpenDDS follows a null pointer here.
    request, _ = meeting.request()
    introduction = replace(request.introduction, key_agreement=name)
    with pytest.raises(VerificationError, match="the peer asks for"):
        meeting.reply(replace(request, introduction=introduction, hash_c1=None))


def test_a_replier_that_chooses_another_agreement_is_refused(now):
    # Cyclone DDS lets it, so here the replier even signs it.
    meeting = Meeting(now, "ml-dsa-65", HYBRID)
    request, waiting = meeting.request()
    weaker, _ = begin(meeting.of_alice, ECDH)
    reply, _ = meeting.reply(replace(weaker, challenge1=request.challenge1))
    with pytest.raises(VerificationError, match="not what was asked for"):
        waiting.receive(reply, now=now)


def test_the_plain_key_alone_is_enough_only_if_the_policy_says_so(now):
    kind = ("ecdsa-p256", "ml-dsa-65")
    strict = PeerRequirements(agreements=(HYBRID,), require_alternative=True)
    meeting = Meeting(now, kind, HYBRID)
    plain = replace(meeting.alice, key=keys(kind, "alice")[0])
    request, _ = begin(Terms(own=plain, policy=EVERYTHING), HYBRID)
    meeting.reply(request)
    with pytest.raises(VerificationError, match=r"c\.dsign_algo 'ECDSA-SHA256'"):
        reply_to(replace(meeting.of_bob, policy=strict), request, now=now)


def test_a_policy_for_alternative_keys_refuses_a_peer_without(now):
    strict = PeerRequirements(agreements=(HYBRID,), require_alternative=True)
    meeting = Meeting(now, "ecdsa-p256", HYBRID)
    request, _ = meeting.request()
    with pytest.raises(VerificationError, match="no alternative key"):
        reply_to(replace(meeting.of_bob, policy=strict), request, now=now)


# Secrets


@pytest.mark.parametrize(
    "dh1", [b"", b"\0", b"\4" + bytes(64), b"\xff" * 65, bytes(1 << 18)], ids=len
)
def test_a_dh1_that_is_no_key_is_refused(meeting, dh1):
    request, _ = meeting.request()
    with pytest.raises(VerificationError, match="ecdh-p256"):
        meeting.reply(replace(request, dh1=dh1))


def signed_again(reply, request, meeting, dh2):
    """The Reply that an honest Bob would sign if his ciphertext were `dh2`."""
    transcript = Transcript(
        hash_c1=request.hash_c1,
        hash_c2=reply.hash_c2,
        challenge1=reply.challenge1,
        challenge2=reply.challenge2,
        dh1=request.dh1,
        dh2=dh2,
    )
    signature = meeting.bob.key.sign_handshake(transcript.reply_octets())
    return replace(reply, dh2=dh2, signature=signature)


def test_a_dh2_that_is_no_ciphertext_is_refused_even_if_it_is_signed(now):
    meeting = Meeting(now, "ml-dsa-65", HYBRID)
    request, waiting = meeting.request()
    reply, _ = meeting.reply(request)
    for dh2 in (b"", reply.dh2[:-1], reply.dh2[:-32] + bytes(32)):
        with pytest.raises(VerificationError, match="ciphertext"):
            waiting.receive(signed_again(reply, request, meeting, dh2), now=now)


def test_a_wrong_ml_kem_ciphertext_shows_only_at_the_first_protected_message(now):
    # Implicit rejection: the handshake has no key confirmation.
    meeting = Meeting(now, "ml-dsa-65", HYBRID)
    request, waiting = meeting.request()
    reply, awaiting = meeting.reply(request)
    wrong = bytes([reply.dh2[0] ^ 1]) + reply.dh2[1:]
    _, one = waiting.receive(signed_again(reply, request, meeting, wrong), now=now)
    other = awaiting._outcome
    sealed = Sender(key_exchange_material(one)).protect_submessage(b"to bob..")
    with pytest.raises(VerificationError, match="different keys"):
        unprotect_submessage(key_exchange_material(other), sealed)


def test_the_secret_of_a_post_quantum_suite_depends_on_the_whole_transcript(now):
    # Same KEM secret, other permissions: other keys. So for pqsec's own suites only.
    for agreement, differs in ((HYBRID, True), (ECDH, False)):
        secret = bytes(32)
        meeting = Meeting(now, agreement=agreement)
        _, one = meeting.reply(meeting.request()[0])
        _, two = meeting.reply(meeting.request()[0])
        secrets = {
            agreement.shared_secret(secret, state.transcript.reply_octets()) for state in (one, two)
        }
        assert (len(secrets) == 2) is differs
