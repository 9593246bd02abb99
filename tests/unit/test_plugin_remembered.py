"""What is remembered of a peer, so that the next participant that meets it does not pay again.

Only what never changes: signatures. Time, revocation and trust anchors decide each time.
"""

from datetime import timedelta

import pytest

from pqsec_pki.algorithms import PublicKey
from pqsec_pki.credentials import _signed_documents as documents
from pqsec_pki.handshake import DataHolder
from pqsec_pki.lifecycle import revoke
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import RefusedError, Shim, properties, shaken, side

LIST = {"org.eclipse.cyclonedds.sec.auth.crl": "file:crl.pem"}
TOKEN = DataHolder("DDS:Access:Permissions:1.0")
NAMES = ("/eve", "/listener", "/talker")


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    return made(tmp_path_factory.mktemp("k") / "k", "transition", names=NAMES)


@pytest.fixture
def verified(monkeypatch):
    """The signatures that are verified on certificates and documents."""
    found, plain = [], PublicKey.verify

    def verify(self, signature, *others):
        found.append(signature)
        return plain(self, signature, *others)

    monkeypatch.setattr(PublicKey, "verify", verify)
    return found


def folder(keystore, name):
    return keystore.root / f"enclaves/{name}"


def test_a_second_participant_that_meets_a_peer_does_not_verify_its_certificate_again(
    keystore, verified
):
    talker, *listeners = (side(folder(keystore, each)) for each in ("talker", *["listener"] * 3))
    del verified[:]
    first = shaken(talker, listeners[0])
    assert len(set(verified)) == len(verified) == 4  # each certificate has two signatures
    for each in listeners[1:]:
        assert shaken(talker, each)
    assert len(verified) == 4
    assert first


def test_a_peer_whose_certificate_was_verified_is_refused_once_it_has_expired(keystore):
    talker, *listeners = (side(folder(keystore, each)) for each in ("talker", *["listener"] * 2))
    known = shaken(talker, listeners[0])
    for shim, *_ in (talker, listeners[1]):
        shim.now = NOW + 800 * DAY
    with pytest.raises(RefusedError, match="expired on"):
        shaken(talker, listeners[1])
    assert known


def test_a_peer_whose_certificate_was_verified_is_refused_once_it_is_revoked(tmp_path):
    store = made(tmp_path / "k", "pq", names=NAMES)
    revoke(store, store.unlock(None), ["/eve"], now=NOW)
    talker = side(folder(store, "talker"))
    known = shaken(talker, side(folder(store, "listener"), **LIST))
    revoke(store, store.unlock(None), ["/talker"], now=NOW)
    with pytest.raises(RefusedError, match="was revoked on"):
        shaken(talker, side(folder(store, "listener"), **LIST))
    assert known


def test_a_certificate_that_one_ca_signed_is_verified_with_the_key_of_another(keystore, tmp_path):
    """Both CAs have the same name."""
    other = made(tmp_path / "other", "transition")
    talker = side(folder(keystore, "talker"))
    known = shaken(talker, side(folder(keystore, "listener")))
    with pytest.raises(RefusedError, match="is not signed by this CA"):
        shaken(talker, side(folder(other, "listener")))
    assert known


def rights(shim, folder, handle):
    """A local participant's, with that identity's handle."""
    pairs, where = properties(folder)
    shim.call("validate_local_permissions", handle, 0, where, pairs)


def credential(folder):
    texts = [(folder / name).read_text() for name in ("cert.pem", "permissions.p7s")]
    return DataHolder("", tuple(zip(("c.id", "c.perm"), texts, strict=True)))


def test_the_documents_of_a_peer_are_verified_once_however_many_meet_it(tmp_path, verified):
    """More peers than the 16 documents that were remembered before."""
    names = tuple(f"/peer{number}" for number in range(20))
    store = made(tmp_path / "k", "classical", names=names)
    shim, peers = Shim("access_control", NOW), [credential(folder(store, each)) for each in names]
    for handle in (1, 2):
        rights(shim, folder(store, names[0]), handle)
    del verified[:]
    for handle in (1, 2):
        for each in peers:
            shim.call("validate_remote_permissions", handle, 9, TOKEN, each)
    assert len(verified) == len(names) - 1  # the first is our own


def test_permissions_that_were_verified_are_refused_once_their_grant_or_signer_ends(keystore):
    shim, peer = Shim("access_control", NOW), credential(folder(keystore, "talker"))
    rights(shim, folder(keystore, "listener"), 1)
    shim.call("validate_remote_permissions", 1, 9, TOKEN, peer)
    for days in (800, 8000):
        shim.now = NOW + timedelta(days=days)
        with pytest.raises(RefusedError, match=r"not valid now|expired on"):
            shim.call("validate_remote_permissions", 1, 9, TOKEN, peer)


def test_documents_are_remembered_by_their_size_the_latest_ones(monkeypatch):
    monkeypatch.setattr(documents, "MAX_REMEMBERED", 10)
    read = []

    @documents._Remembered
    def reading(document, *, more=0):
        read.append(document)
        return document, more

    for each in (b"1234", b"5678", b"1234", b"9", b"abc", b"1234", b"5678"):
        assert reading(each) == (each, 0)
    assert read == [b"1234", b"5678", b"9", b"abc", b"5678"]
    assert reading(b"1234", more=1) == (b"1234", 1)
    assert reading(b"larger than all") == reading(b"larger than all")
    assert read[-2:] == [b"larger than all"] * 2


def test_a_document_that_is_refused_is_not_remembered():
    count = []

    @documents._Remembered
    def refusing(document):
        count.append(document)
        raise ValueError

    for _ in range(2):
        with pytest.raises(ValueError, match=r"^$"):
            refusing(b"x")
    assert len(count) == 2
