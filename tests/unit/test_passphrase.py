"""Another passphrase: all CA keys have it at once, and the old files hold nothing."""

import pytest

from pqsec_pki.algorithms import is_encrypted, load_private_key
from pqsec_pki.errors import KeystoreError, PassphraseError
from pqsec_pki.keystore import Keystore, audit
from pqsec_pki.lifecycle import Rollover, change_passphrase
from tests.unit.keystores import NOW, made, rotate


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def keys(keystore):
    return sorted((keystore.root / "private").glob("*.key.pem"))


def change(keystore, old, new):
    return change_passphrase(keystore, keystore.unlock(old), new)


@pytest.mark.parametrize("profile", ["transition", "pq"])
def test_it_is_set_changed_and_removed(tmp_path, profile):
    keystore = made(tmp_path / "k", profile)
    before = [load_private_key(path.read_bytes()).public_key.spki for path in keys(keystore)]
    for old, new in ((None, b"one"), (b"one", b"two"), (b"two", b"two"), (b"two", None)):
        assert change(keystore, old, new) == keys(keystore)
        for path in keys(keystore):
            assert is_encrypted(path.read_bytes()) == (new is not None)
            assert path.stat().st_mode & 0o777 == 0o600
        found = [load_private_key(path.read_bytes(), new) for path in keys(keystore)]
        assert [key.public_key.spki for key in found] == before
        if new is not None:
            with pytest.raises(PassphraseError):
                keystore.unlock(b"another")
    audit(keystore)


@pytest.mark.parametrize(("old", "new"), [(None, b"new"), (b"old", b"new"), (b"old", None)])
def test_what_the_old_files_held_is_overwritten(keystore, old, new):
    change(keystore, None, old)
    sizes = {path: path.stat().st_size for path in keys(keystore)}
    files = {path: path.open("rb") for path in keys(keystore)}  # they live on without a name
    change(keystore, old, new)
    for path, file in files.items():
        with file:
            assert file.read() == bytes(sizes[path])


def test_a_wrong_passphrase_changes_nothing(keystore):
    change(keystore, None, b"right")
    before = [path.read_bytes() for path in keys(keystore)]
    with pytest.raises(PassphraseError):
        change(keystore, b"wrong", b"new")
    assert [path.read_bytes() for path in keys(keystore)] == before


def test_cas_that_made_way_meanwhile_are_not_put_back(keystore):
    old = keystore.unlock(None)
    rotate(keystore, Rollover(profile=keystore.profile), passphrase=None, now=NOW)
    with pytest.raises(KeystoreError, match="has been replaced by another CA meanwhile"):
        change_passphrase(keystore, old, b"new")
    Keystore.open(keystore.root).unlock(None)


def test_a_key_that_is_a_link_is_refused(keystore, tmp_path):
    path = keystore.root / "private/identity_ca.key.pem"
    path.rename(tmp_path / "stick.pem")
    path.symlink_to(tmp_path / "stick.pem")
    with pytest.raises(KeystoreError, match="the key that it leads to would not change"):
        change(keystore, None, b"secret")
    assert path.is_symlink()
    keystore.unlock(None)
