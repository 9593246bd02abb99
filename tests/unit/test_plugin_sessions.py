"""What changes while participants live: who is revoked, what ends, and floods of strangers."""

import shutil
from datetime import timedelta
from types import SimpleNamespace

import pytest

from pqsec_pki.certificates import Authority
from pqsec_pki.handshake import participant_data
from pqsec_pki.lifecycle import revoke
from pqsec_pki.plugin import handles, notes, peer_table
from pqsec_pki.plugin.authentication import NO_TOKEN, ValidationResult
from pqsec_pki.plugin.notes import Notes
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import (
    IDENTITY,
    RefusedError,
    Shim,
    new_guid,
    properties,
    shaken,
    side,
)

LIST = "org.eclipse.cyclonedds.sec.auth.crl"
EVE = "/eve"


@pytest.fixture
def keystore(tmp_path):
    """With a list that takes nobody back who is asked for here."""
    store = made(tmp_path / "k", "transition", names=("/listener", "/talker", EVE))
    revoke(store, store.unlock(None), [EVE], now=NOW)
    return store


def folder(keystore, name):
    return keystore.root / f"enclaves/{name}"


def both(keystore, **more):
    """Listener and talker after their handshake, each as (shim, identity, the other's handle)."""
    sides = [side(folder(keystore, name), **more) for name in ("listener", "talker")]
    ends = shaken(*sides)
    return [
        (shim, identity, next(peer for one, _, peer in ends if one is shim))
        for shim, identity, _ in sides
    ]


def with_list(keystore):
    return both(keystore, **{LIST: "file:crl.pem"})


def told(shim):
    """All that it says are revoked now."""
    found = []
    while handle := shim.call("find_revoked")[1]:
        found.append(handle)
    return found


def test_a_peer_that_is_revoked_in_mid_session_is_told_once(keystore):
    (listener, _, talker), _ = with_list(keystore)
    assert told(listener) == []
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert told(listener) == [talker]
    assert told(listener) == []


def test_a_participant_that_is_revoked_itself_is_told(keystore):
    _, (talker, own, _) = with_list(keystore)
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert told(talker) == [own]


def test_a_newer_list_counts_for_the_next_handshake_too(keystore):
    listener = side(folder(keystore, "listener"), **{LIST: "file:crl.pem"})
    talker = side(folder(keystore, "talker"))
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert told(listener[0]) == []  # nobody that it knows
    with pytest.raises(RefusedError, match="was revoked on"):
        shaken(listener, talker)


def test_a_peer_that_is_revoked_within_the_handshake_gets_no_secret(keystore):
    """Its certificate was looked at before, with the list of then."""
    (listener, own, guid), (talker, theirs, peers) = (
        side(folder(keystore, name), **{LIST: "file:crl.pem"}) for name in ("listener", "talker")
    )
    _, seen, _ = talker.call("validate_remote_identity", NO_TOKEN, theirs, IDENTITY, guid)
    _, known, _ = listener.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, peers)
    data = [participant_data(each) for each in (guid, peers)]
    _, begun, token = listener.call("begin_handshake_request", own, known, data[0])
    *_, token = talker.call("begin_handshake_reply", token, seen, theirs, data[1])
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert told(listener) == []  # not a peer yet
    listener.call("process_handshake", token, begun)
    with pytest.raises(RefusedError, match="talker was revoked meanwhile"):
        listener.call("get_shared_secret", begun)
    assert told(listener) == [known]


def test_of_several_peers_the_guid_is_checked_of_the_one_that_is_asked_about(tmp_path):
    store = made(tmp_path / "k", "classical", names=("/listener", "/one", "/other"))
    listener, candidates, peers = side(folder(store, "listener")), [], []
    for name in ("one", "other"):
        shim, (pairs, where) = Shim("authentication"), properties(folder(store, name))
        candidate = new_guid()
        _, handle, guid, *_ = shim.call("validate_local_identity", 0, where, pairs, candidate)
        ends = shaken(listener, (shim, handle, guid))
        candidates.append((guid, candidate))
        peers += [peer for one, _, peer in ends if one is listener[0]]
    for peer, (guid, candidate) in zip(peers, candidates, strict=True):
        listener[0].call("check_guid_comes_from", peer, guid, candidate)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: path.write_bytes(b"half a li"), "not one revocation list in PEM"),
    ],
)
def test_a_list_that_cannot_be_read_leaves_the_former_in_force(keystore, spoil, words):
    (listener, _, talker), _ = with_list(keystore)
    path = folder(keystore, "listener") / "crl.pem"
    path = path.parent / path.readlink() if path.is_symlink() else path
    good = path.read_bytes()
    spoil(path)
    with pytest.raises(RefusedError, match=words):
        told(listener)
    path.write_bytes(good)
    assert told(listener) == []
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert told(listener) == [talker]


def test_a_list_of_another_ca_takes_nobody_back(keystore, tmp_path):
    (listener, *_), _ = with_list(keystore)
    other = made(tmp_path / "other", "transition")
    revoke(other, other.unlock(None), ["/talker"], now=NOW)
    path = folder(keystore, "listener") / "crl.pem"
    path.unlink()
    path.write_bytes((other.root / "enclaves/talker/crl.pem").read_bytes())
    with pytest.raises(RefusedError, match="not signed by this CA"):
        told(listener)


def test_where_there_is_no_list_nothing_is_to_be_asked(keystore):
    pairs, where = properties(folder(keystore, "talker"))
    shim = Shim("authentication")
    *_, ask = shim.call("validate_local_identity", 0, where, pairs, new_guid())
    pairs += ((LIST, "file:crl.pem"),)
    *_, ask_too = shim.call("validate_local_identity", 0, where, pairs, new_guid())
    assert (ask, ask_too) == (0, 1)


def shorter(authority, name):
    """The certificate of the same CA, as it was first made for ten days only."""
    algorithm = SimpleNamespace(generate=lambda: authority.key)
    return Authority.create(name, algorithm, now=NOW, validity=10 * DAY).certificate


@pytest.fixture
def brief(tmp_path):
    """An enclave for 90 days, whose identity CA ends after ten."""
    store = made(tmp_path / "k", "pq")
    enclave = tmp_path / "brief"
    shutil.copytree(folder(store, "talker"), enclave, symlinks=False)
    ca = shorter(store.unlock(None).identity, "Test Identity CA")
    (enclave / "identity_ca.cert.pem").write_bytes(ca.pem)
    return enclave


def test_an_identity_ends_with_its_ca(brief):
    pairs, where = properties(brief)
    shim = Shim("authentication")
    *_, end, _ = shim.call("validate_local_identity", 0, where, pairs, new_guid())
    assert end == (NOW + 10 * DAY).timestamp() + 1


def test_a_peer_ends_with_its_ca(brief):
    ends = shaken(side(brief), side(brief))
    for shim, handshake, _ in ends:
        assert shim.call("get_shared_secret", handshake)[2] == (NOW + 10 * DAY).timestamp() + 1


def test_a_peer_ends_with_its_ca_where_that_is_the_second_in_the_file(brief, tmp_path):
    own = folder(made(tmp_path / "own", "pq"), "listener")
    cas = [(each / "identity_ca.cert.pem").read_bytes() for each in (own, brief)]
    for each, both_cas in ((own, cas), (brief, cas[::-1])):
        (each / "identity_ca.cert.pem").unlink()
        (each / "identity_ca.cert.pem").write_bytes(b"".join(both_cas))
    sides = side(own), side(brief)
    found = {
        shim: shim.call("get_shared_secret", handshake)[2] for shim, handshake, _ in shaken(*sides)
    }
    ends = [found[shim] for shim, *_ in sides]
    assert ends == [(NOW + days * DAY).timestamp() + 1 for days in (10, 90)]


def test_nobody_is_met_once_the_ca_has_ended(brief):
    sides = [side(brief), side(brief)]
    for shim, *_ in sides:
        shim.now = NOW + 11 * DAY
    with pytest.raises(RefusedError, match="expired on"):
        shaken(*sides)


def test_a_flood_of_strangers_evicts_only_strangers_and_is_told(keystore, monkeypatch):
    monkeypatch.setattr(peer_table, "MAX_WAITING", 3)
    (listener, identity, talker), _ = both(keystore)
    crowd = [
        listener.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, new_guid())[1]
        for _ in range(10)
    ]
    for peer in crowd[-3:]:
        assert listener.call("begin_handshake_request", identity, peer, b"")[0] == (
            ValidationResult.PENDING_HANDSHAKE_MESSAGE
        )
    with pytest.raises(RefusedError, match="does not know the handle"):
        listener.call("begin_handshake_request", identity, crowd[0], b"")
    _, handshake, _ = listener.call("begin_handshake_request", identity, talker, b"")
    assert handshake
    told_of = [line for line in listener.log if "more than 3 peers have not authenticated" in line]
    assert len(told_of) == 1
    # the participant, its peer and their handshake, three strangers and their handshakes
    assert listener.connection.what[2] == 3 + 3 + 3


def test_a_flood_leaves_room_where_a_process_has_many_participants(keystore, monkeypatch):
    """Each of them begins a handshake with each stranger."""
    monkeypatch.setattr(peer_table, "MAX_WAITING", 8)
    monkeypatch.setattr(handles, "MAX_OBJECTS", 32)
    monkeypatch.setattr(handles, "SPARE", 2)
    (listener, identity, _), _ = both(keystore)
    own = [identity, *(listener.identity(folder(keystore, "listener"))[0] for _ in range(5))]
    for _ in range(20):
        guid = new_guid()
        for each in own:
            _, peer, _ = listener.call("validate_remote_identity", NO_TOKEN, each, IDENTITY, guid)
            assert listener.call("begin_handshake_request", each, peer, b"")[1]
    assert listener.connection.what[2] <= 30
    assert any("the oldest unauthenticated peer is dropped" in line for line in listener.log)
    own_guid = listener.identity(folder(keystore, "listener"))
    assert shaken((listener, *own_guid), side(folder(keystore, EVE.strip("/"))))


def test_who_begins_a_handshake_is_not_itself_the_one_that_makes_room(keystore, monkeypatch):
    monkeypatch.setattr(handles, "MAX_OBJECTS", 5)
    monkeypatch.setattr(handles, "SPARE", 1)
    shim, identity, _ = side(folder(keystore, "listener"))
    oldest, second, third = (
        shim.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, new_guid())[1]
        for _ in range(3)
    )
    for peer in (oldest, oldest, third):
        assert shim.call("begin_handshake_request", identity, peer, b"")[1]
    with pytest.raises(RefusedError, match="does not know the handle"):
        shim.call("begin_handshake_request", identity, second, b"")


def lines_of(count, *, apart=timedelta(), text="refused: {}".format):
    """What the log has of so many lines."""
    now, log = [NOW], []
    noted = Notes("host[1]", log.append, lambda: now[0])
    for number in range(count):
        noted.add(text(number))
        now[0] += apart
    noted.finish()
    return log


def test_a_line_that_comes_again_and_again_is_written_once():
    log = lines_of(5000, text="no".format)
    assert log == ["host[1]: no", "host[1]: 4999 lines like these were left out since 12:00:00"]


def test_a_flood_of_different_lines_has_an_end():
    log = lines_of(5000)
    assert log[: notes.MOST] == [f"host[1]: refused: {each}" for each in range(notes.MOST)]
    assert "counted, not written" in log[notes.MOST]
    assert f"{5000 - notes.MOST} lines like these" in log[notes.MOST + 1]
    assert len(log) == notes.MOST + 2


def test_lines_that_come_slowly_are_all_written():
    log = lines_of(20, apart=notes.WINDOW * 1.1, text="no".format)
    assert log == ["host[1]: no"] * 20


def test_a_peer_that_is_refused_a_thousand_times_does_not_fill_the_log(keystore):
    shim, identity, _ = side(folder(keystore, "talker"))
    for _ in range(1000):
        with pytest.raises(RefusedError):
            shim.call("validate_remote_identity", NO_TOKEN, identity, NO_TOKEN, new_guid())
    assert len(shim.log) == 1
