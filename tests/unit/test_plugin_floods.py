"""Messages of unauthenticated peers: what they may cost, and what they may not undo."""

import gc
import os
from collections import Counter
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import DataHolder, ReplySent, adjusted_guid, participant_data
from pqsec_pki.plugin import pending
from pqsec_pki.plugin.authentication import NO_TOKEN, ValidationResult
from pqsec_pki.plugin.pending import BURST, COST, PER_SECOND, PendingReplies, Rates
from tests.unit.keystores import NOW, made
from tests.unit.plugin_wire import (
    IDENTITY,
    RefusedError,
    Shim,
    half_shaken,
    new_guid,
    properties,
    shaken,
    side,
)

LARGE = 240_000
"""Octets of a document; a token may have 256 kB."""
ONE_SECOND = timedelta(seconds=1)


@pytest.fixture(scope="module")
def enclaves(tmp_path_factory):
    names = ("/listener", "/talker", "/eve")
    root = made(tmp_path_factory.mktemp("k") / "k", "classical", names=names).root
    return {name.strip("/"): root / f"enclaves{name}" for name in names}


class Forger:
    """Who has heard a participant's Request to `victim`, a (Shim, identity, GUID)."""

    def __init__(self, folder, victim):
        shim, own, guid = side(folder)
        _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, victim[2])
        *_, self.heard = shim.call("begin_handshake_request", own, peer, participant_data(guid))
        self.victim = victim
        self.subject = Certificate.from_pem((folder / "cert.pem").read_bytes()).subject_der

    def request(self, guid, *, document):
        """The Request, in the name of `guid`, with that document."""
        items = dict(self.heard.binary_properties)
        items |= {"c.perm": document, "c.pdata": participant_data(guid)}
        del items["hash_c1"]
        return DataHolder(self.heard.class_id, (), tuple(items.items()))

    def send(self, *, size=0, document=None):
        """Be discovered as somebody new, and begin a handshake: its handle.

        With `document`, or a random one of `size` octets.
        """
        shim, own, _ = self.victim
        guid = adjusted_guid(self.subject, new_guid())
        _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, guid)
        return self.answered(guid, peer, size=size, document=document)

    def answered(self, guid, peer, *, size=0, document=None):
        shim, own, _ = self.victim
        request = self.request(guid, document=document or os.urandom(size))
        data = participant_data(self.victim[2])
        return shim.call("begin_handshake_reply", request, peer, own, data)[1]


def test_forged_requests_hold_so_much_and_no_more_and_a_participant_is_still_served(enclaves):
    answers = PendingReplies()
    shim = Shim("authentication", answers=answers)
    victim = (shim, *shim.identity(enclaves["listener"]))
    forger = Forger(enclaves["eve"], victim)
    final, handle = half_shaken(side(enclaves["talker"]), victim)
    for _ in range(150):
        forger.send(size=LARGE)
    assert 0.9 * pending.MAX_HELD < answers.held <= pending.MAX_HELD
    assert shim.call("process_handshake", final, handle) == [ValidationResult.OK, NO_TOKEN]
    assert shaken(victim, side(enclaves["talker"]))
    assert sum("hold more than" in line for line in shim.log) == 1


def test_documents_that_end_in_nul_hold_no_more_than_is_counted(enclaves):
    """What is kept is the document without its NULs: that is to be one object, not what came."""
    answers = PendingReplies()
    shim = Shim("authentication", answers=answers)
    forger = Forger(enclaves["eve"], (shim, *shim.identity(enclaves["listener"])))
    document = os.urandom(LARGE - 1) + b"x"
    count = 100
    for number in range(count):
        forger.send(document=document + bytes(1 + number % 3))
    states = [each for each in gc.get_objects() if isinstance(each, ReplySent)]
    kept = [each.peer.permissions for each in states if each.peer.permissions == document]
    assert len(kept) == count
    held = sum({id(each): len(each) for each in kept}.values())
    assert held <= pending.MAX_HELD
    assert answers.held == count * COST + held
    with pytest.raises(ValueError, match="not the peer's"):
        states[-1].sharing(states[-1].peer.permissions + b"\0")


def test_a_flood_in_one_name_on_one_connection_is_the_whole_agents(enclaves):
    answers = PendingReplies()
    for name in ("listener", "talker"):
        shim = Shim("authentication", answers=answers)
        forger = Forger(enclaves["eve"], (shim, *shim.identity(enclaves[name])))
        for _ in range(50):
            forger.send(size=LARGE)
    assert answers.held <= pending.MAX_HELD


def test_of_a_name_that_is_forged_the_real_one_is_not_the_first_to_go(enclaves):
    """With documents that are larger than its own."""
    shim, *own = side(enclaves["listener"])
    forger = Forger(enclaves["talker"], (shim, *own))
    final, handle = half_shaken(side(enclaves["talker"]), (shim, *own))
    for _ in range(100):
        forger.send(size=LARGE)
    assert shim.call("process_handshake", final, handle) == [ValidationResult.OK, NO_TOKEN]


def test_a_handshake_that_had_to_make_room_is_unknown_and_takes_no_handle(enclaves, monkeypatch):
    victim = side(enclaves["listener"])
    forger = Forger(enclaves["talker"], victim)
    monkeypatch.setattr(pending, "MAX_HELD", 10 * COST)
    begun = [forger.send(size=100) for _ in range(20)]
    with pytest.raises(RefusedError, match="does not know the handle"):
        victim[0].call("process_handshake", NO_TOKEN, begun[0])
    peers = len(begun)
    assert victim[0].connection.what[2] < 1 + peers + 10


def kept(*wanted, limit, monkeypatch):
    """Which numbers are left of `wanted`, pairs of a certificate and a document."""
    monkeypatch.setattr(pending, "MAX_HELD", limit)
    answers, left = PendingReplies(), set()
    for number, (who, document) in enumerate(wanted, 1):
        left.add(number)
        assert answers.add(who, document, lambda number=number: left.remove(number)) == number
        answers.make_room()
    assert len(answers) == len(left)
    return left


@pytest.fixture
def names(enclaves):
    return [Certificate.from_pem((each / "cert.pem").read_bytes()) for each in enclaves.values()]


def test_who_has_to_make_room(names, monkeypatch):
    """The name with most, there the largest, of these the oldest."""
    one, other, _ = names
    limit = 4 * COST + 500
    flood = [(one, bytes([number]) * 100) for number in range(9)]
    assert kept((other, b"x" * 150), *flood, limit=limit, monkeypatch=monkeypatch) == {1, 8, 9, 10}
    small = [(one, b"small"), *flood]
    assert kept(*small, limit=limit, monkeypatch=monkeypatch) == {1, 8, 9, 10}
    assert kept((one, b"x" * (limit + 1)), limit=limit, monkeypatch=monkeypatch) == {1}


def test_equal_documents_of_one_name_are_kept_and_counted_once(names, monkeypatch):
    one, other, _ = names
    answers = PendingReplies()
    documents = [os.urandom(8) * 1000 for _ in range(2)]
    numbers = []
    for who, document in ((one, 0), (one, 0), (other, 0), (one, 1)):
        found = answers.one_copy(who, bytes(bytearray(documents[document])))
        numbers.append(answers.add(who, found, lambda: None))
    assert answers.held == 4 * COST + 3 * 8000
    for left in (4 * COST + 3 * 8000 - COST, 2 * COST + 16000, COST + 8000, 0):
        answers.drop(numbers.pop(0))
        assert answers.held == left
    document = documents[0]
    answers.add(one, document, lambda: None)
    assert answers.one_copy(one, bytes(bytearray(document))) is document
    assert answers.one_copy(other, bytes(bytearray(document))) is not document


def test_processes_with_one_identity_cost_one_document(enclaves):
    """Their certificate and document are kept once, however often they come."""
    answers = PendingReplies()
    shim = Shim("authentication", answers=answers)
    victim = (shim, *shim.identity(enclaves["listener"]))
    document = Shim("access_control")
    pairs, where = properties(enclaves["talker"])
    _, rights, _ = document.call("validate_local_permissions", 1, 0, where, pairs)
    credential = document.call("get_permissions_credential_token", rights)[1]
    for _ in range(3):
        own = Shim("authentication")
        identity, guid = own.identity(enclaves["talker"])
        own.call("set_permissions_credential_and_token", identity, credential, NO_TOKEN)
        half_shaken((own, identity, guid), victim)
    text = (enclaves["talker"] / "permissions.p7s").read_bytes()
    assert answers.held == 3 * COST + len(text)
    states = [each for each in gc.get_objects() if isinstance(each, ReplySent)]
    peers = [each.peer for each in states if each.peer.permissions == text]
    assert len(peers) == 3
    assert len({id(each.certificate) for each in peers}) == 1
    assert len({id(each.permissions) for each in peers}) == 1


def test_a_name_is_answered_so_often_and_then_again_after_a_while(names):
    one, other, _ = names
    rates, now = Rates(), NOW

    def answered(who, *, at):
        count = 0
        while count <= 10 * BURST:
            try:
                rates.refuse_early(who, at)
            except VerificationError:
                return count
            rates.count(who, at)
            count += 1
        return count

    assert answered(one, at=now) == BURST
    rates.count(other, now)
    assert answered(other, at=now - 1000 * ONE_SECOND) == BURST - 1  # the clock was set back
    rates = Rates()
    assert answered(one, at=now) == BURST
    assert answered(one, at=now) == 0
    assert answered(other, at=now) == BURST
    rates, _ = Rates(), answered(one, at=now)
    assert answered(one, at=now) == BURST
    assert answered(one, at=now + 2 * ONE_SECOND) == 2 * PER_SECOND
    assert answered(one, at=now + 9999 * ONE_SECOND) == BURST


def test_requests_that_are_refused_do_not_count_against_their_name(enclaves, monkeypatch):
    monkeypatch.setattr(pending, "BURST", 2)
    victim = side(enclaves["listener"])
    forger = Forger(enclaves["talker"], victim)
    heard = forger.heard
    own = (enclaves["talker"] / "cert.pem").read_bytes()
    for at in (200, 250, 300):  # of a certificate that is altered, with the same name
        spoilt = own[:at] + (b"B" if own[at : at + 1] == b"A" else b"A") + own[at + 1 :]
        items = dict(heard.binary_properties) | {"c.id": spoilt}
        forger.heard = replace(heard, binary_properties=tuple(items.items()))
        with pytest.raises(RefusedError):
            forger.send(size=9)
    forger.heard = heard
    assert [bool(forger.send(size=9)) for _ in range(2)] == [True, True]
    with pytest.raises(RefusedError, match="this one must be repeated"):
        forger.send(size=9)
    victim[0].now += ONE_SECOND
    assert forger.send(size=9)


def finished(enclaves):
    """Listener's side of a handshake that talker began: (Shim, identity, GUID), who, handles."""
    shim, own, guid = side(enclaves["listener"])
    other, theirs, peers = side(enclaves["talker"])
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, peers)
    _, known, _ = other.call("validate_remote_identity", NO_TOKEN, theirs, IDENTITY, guid)
    talker = (other, theirs, known, participant_data(peers))

    def begin():
        _, begun, request = other.call("begin_handshake_request", *talker[1:])
        data = participant_data(guid)
        _, handle, reply = shim.call("begin_handshake_reply", request, peer, own, data)
        return handle, other.call("process_handshake", reply, begun)[1]

    handle, final = begin()
    shim.call("process_handshake", final, handle)
    return (shim, own, guid), peers, (peer, handle), begin


def test_a_forged_request_does_not_undo_a_finished_handshake(enclaves):
    victim, guid, (peer, handle), begin = finished(enclaves)
    shim = victim[0]
    secret = shim.call("get_shared_secret", handle)
    forger = Forger(enclaves["talker"], victim)
    assert forger.answered(guid, peer, size=9) == handle
    assert shim.call("get_shared_secret", handle) == secret
    with pytest.raises(RefusedError, match="signature"):
        shim.call("process_handshake", replace_signature(begin()[1]), handle)
    assert shim.call("get_shared_secret", handle) == secret
    again, final = begin()  # a peer that has the key may begin again
    assert shim.call("get_shared_secret", handle) == secret
    assert shim.call("process_handshake", final, again) == [ValidationResult.OK, NO_TOKEN]
    assert shim.call("get_shared_secret", handle)[5] != secret[5]


def replace_signature(final):
    items = dict(final.binary_properties) | {"signature": bytes(64)}
    return replace(final, binary_properties=tuple(items.items()))


def test_a_flood_does_not_undo_a_finished_handshake_that_was_begun_again(enclaves, monkeypatch):
    victim, guid, (peer, handle), _ = finished(enclaves)
    secret = victim[0].call("get_shared_secret", handle)
    forger = Forger(enclaves["talker"], victim)
    monkeypatch.setattr(pending, "MAX_HELD", 10 * COST)
    forger.answered(guid, peer, size=LARGE)
    for _ in range(20):
        forger.send(size=100)
    assert victim[0].call("get_shared_secret", handle) == secret


def test_a_forged_request_does_not_undo_our_own(enclaves):
    """We have sent a Request, and wait for the Reply."""
    victim, other = side(enclaves["listener"]), side(enclaves["talker"])
    (shim, own, guid), (theirs, identity, peers) = victim, other
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, peers)
    _, seen, _ = theirs.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, guid)
    data = participant_data(guid), participant_data(peers)
    _, begun, request = shim.call("begin_handshake_request", own, peer, data[0])
    forger = Forger(enclaves["talker"], victim)
    assert forger.answered(peers, peer, size=9) == begun
    _, _, reply = theirs.call("begin_handshake_reply", request, seen, identity, data[1])
    assert shim.call("process_handshake", reply, begun)[0] == ValidationResult.OK_FINAL_MESSAGE


def discovered(shim, own, guid, heard=NO_TOKEN):
    """The peer's handle, and our AuthRequest."""
    return shim.call("validate_remote_identity", heard, own, IDENTITY, guid)[1:]


@pytest.mark.parametrize("loser", ["initiator", "replier"])
def test_a_peer_that_is_lost_for_a_moment_is_met_again_at_once(enclaves, loser):
    """At load, leases end. The other side has not noticed, and keeps the challenge that it got:
    it refused all handshakes until its own timed out, after 100 seconds."""
    sides = [side(enclaves[name]) for name in ("listener", "talker")]
    (one, own, guid), (other, theirs, peers) = sorted(sides, key=lambda each: each[2])
    if loser == "initiator":
        known, first = discovered(one, own, peers)
        seen, _ = discovered(other, theirs, guid, first)
        one.call("return_identity_handle", known)
        known, second = discovered(one, own, peers)
    else:
        seen, first = discovered(other, theirs, guid)
        known, _ = discovered(one, own, peers, first)
        other.call("return_identity_handle", seen)
        seen, second = discovered(other, theirs, guid)
    assert second == first
    data = participant_data(guid), participant_data(peers)
    _, begun, token = one.call("begin_handshake_request", own, known, data[0])
    _, answered, token = other.call("begin_handshake_reply", token, seen, theirs, data[1])
    _, token = one.call("process_handshake", token, begun)
    assert other.call("process_handshake", token, answered) == [ValidationResult.OK, NO_TOKEN]
    again = (one, own, peers) if loser == "initiator" else (other, theirs, guid)
    assert discovered(*again)[1] != first  # a later handshake has a challenge of its own


def test_a_reply_that_comes_late_or_twice_is_told_as_that(enclaves):
    """As from a slow network or agent; it is no attack, and the log must not look like one."""
    victim, other = side(enclaves["listener"]), side(enclaves["talker"])
    (shim, own, guid), (theirs, identity, peers) = victim, other
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, peers)
    _, seen, _ = theirs.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, guid)
    data = participant_data(guid), participant_data(peers)
    replies = []
    for _ in range(2):
        _, begun, request = shim.call("begin_handshake_request", own, peer, data[0])
        replies.append(theirs.call("begin_handshake_reply", request, seen, identity, data[1])[2])
    with pytest.raises(RefusedError, match="given up for a later one: it came late"):
        shim.call("process_handshake", replies[0], begun)
    assert shim.call("process_handshake", replies[1], begun)[0] == ValidationResult.OK_FINAL_MESSAGE
    for each in replies:
        with pytest.raises(RefusedError, match="came late, or twice"):
            shim.call("process_handshake", each, begun)
    assert len(shim.log) == 2
    assert all("process_handshake: ignored: " in line for line in shim.log)
    assert not any("refused" in line for line in shim.log)


def test_a_reply_to_who_waits_for_a_final_is_refused_and_not_told_as_late(enclaves):
    (shim, own, guid), (theirs, identity, peers) = (
        side(enclaves[name]) for name in ("listener", "talker")
    )
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, peers)
    _, seen, _ = theirs.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, guid)
    data = participant_data(guid), participant_data(peers)
    _, begun, request = shim.call("begin_handshake_request", own, peer, data[0])
    _, waits, reply = theirs.call("begin_handshake_reply", request, seen, identity, data[1])
    with pytest.raises(RefusedError, match="Reply"):
        theirs.call("process_handshake", reply, waits)
    assert not any("late" in line for line in theirs.log)
    _, final = shim.call("process_handshake", reply, begun)
    assert theirs.call("process_handshake", final, waits) == [ValidationResult.OK, NO_TOKEN]


KEPT = 16
"""Own introductions whose digest is kept, however many come: so many fill that."""


def census():
    """How many objects of this package and of cryptography there are, by kind."""
    gc.collect()
    kinds = Counter(type(each) for each in gc.get_objects())
    return Counter(
        {
            kind: count
            for kind, count in kinds.items()
            if str(kind.__module__).startswith(("pqsec_pki.plugin", "pqsec_pki.handshake"))
            or kind is Certificate
        }
    )


def come_and_go(enclaves, answers):
    """Two hosts that meet, a forger, and a peer that begins and never ends; all of them leave."""
    shims = [Shim("authentication", answers=answers) for _ in range(2)]
    sides = [
        (shim, *shim.identity(enclaves[name]))
        for shim, name in zip(shims, ("listener", "talker"), strict=True)
    ]
    rights = Shim("access_control")
    pairs, where = properties(enclaves["listener"])
    rights.call("validate_local_permissions", 1, 0, where, pairs)
    shaken(*sides)
    forger = Forger(enclaves["eve"], sides[0])
    for _ in range(3):
        forger.send(size=1000)
    for each in (*shims, rights):
        each.connection.finish()


@pytest.mark.slow
def test_hosts_that_have_gone_leave_nothing_behind(enclaves):
    answers = PendingReplies()
    for _ in range(KEPT):
        come_and_go(enclaves, answers)
    before = census()
    for _ in range(20):
        come_and_go(enclaves, answers)
    assert (answers.held, len(answers)) == (0, 0)
    assert census() - before == Counter()


@pytest.mark.slow
def test_participants_that_have_gone_leave_nothing_behind_in_a_host_that_stays(enclaves):
    shim = Shim("authentication")

    def come():
        victim = (shim, *shim.identity(enclaves["listener"]))
        for one, _, peer in shaken(victim, side(enclaves["talker"])):
            if one is shim:
                one.call("return_identity_handle", peer)
        Forger(enclaves["eve"], victim).send(size=9)
        shim.call("return_identity_handle", victim[1])

    for _ in range(KEPT):
        come()
    before = census()
    for _ in range(10):
        come()
    left = census() - before
    strangers = {each.__name__: count for each, count in left.items()}
    assert strangers == {"Remote": 10}  # who never authenticated, and is still to be returned


def test_peers_that_have_gone_leave_nothing_behind_in_a_host_that_stays(enclaves):
    answers = PendingReplies()
    shim = Shim("authentication", answers=answers)
    victim = (shim, *shim.identity(enclaves["listener"]))

    def meet():
        for one, _, peer in shaken(victim, side(enclaves["talker"])):
            if one is shim:
                one.call("return_identity_handle", peer)

    for _ in range(KEPT):
        meet()
    before = census()
    for _ in range(20):
        meet()
    assert (answers.held, len(answers)) == (0, 0)
    assert shim.connection.what[2] == 1
    assert census() - before == Counter()
