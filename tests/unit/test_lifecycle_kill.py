"""Renewing and revoking survive a kill at any instant, a full disk, and each other."""

import errno
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import pytest

from pqsec_pki.errors import FileError, KeystoreError
from pqsec_pki.keystore import Keystore, audit
from pqsec_pki.lifecycle import Renewal, renew, renew_list, revoke
from pqsec_pki.lifecycle.renewing import Renewer
from tests.unit.killing import (
    NOW,
    at_once,
    check_commitment,
    check_ledger,
    check_no_halves,
    check_whole,
    copies,
    create,
    drafts,
    fails,
    issue_to,
    killed_processes,
)

BOTH = ("/fleet/robot1", "/talker")


def renew_in(root, *names, rekey=True):
    keystore = Keystore.open(root, to_change=True)
    return renew(keystore, keystore.unlock(None), names, Renewal(rekey=rekey), now=NOW)


def revoke_in(root, *subjects):
    keystore = Keystore.open(root, to_change=True)
    return revoke(keystore, keystore.unlock(None), subjects, now=NOW)


def renew_list_in(root):
    keystore = Keystore.open(root, to_change=True)
    return renew_list(keystore, keystore.unlock(None), now=NOW)


def state_of(keystore):
    """Fingerprints, what is revoked, and the number of the list; all of it fits together."""
    check_ledger(keystore)
    found = {name: check_whole(keystore, name) for name in keystore.names()}
    made = keystore.revocation_list
    if made:
        made.verify(keystore.identity_ca, require_alternative=True)
        assert {keystore.participant(name).revocation_list.der for name in found} == {made.der}
    else:
        assert not any(keystore.participant(name).revocation_list for name in found)
    entered = {each.serial for each in keystore.ledger() if each.kind == "revocation"}
    listed = {f"{each.serial_number:x}" for each in made.revoked} if made else set()
    assert listed == entered
    return found, listed, made.number if made else 0


@dataclass(frozen=True)
class Scene:
    """Work on a keystore with /fleet/robot1 and /talker, prepared further by `before`."""

    work: Callable[[Path], object]
    before: Callable[[Path], object] = lambda _: None
    every: int = 25
    """Of how many calls one is killed."""


SCENES = {
    "renewed with new keys": Scene(lambda root: renew_in(root, *BOTH), every=29),
    "renewed with old keys": Scene(lambda root: renew_in(root, *BOTH, rekey=False)),
    "the first revocation": Scene(lambda root: revoke_in(root, "/talker")),
    "another revocation": Scene(
        lambda root: revoke_in(root, "/talker"),
        lambda root: revoke_in(root, "/fleet/robot1"),
        every=13,
    ),
    "a new list": Scene(renew_list_in, lambda root: revoke_in(root, "/talker")),
    "issued beside a list": Scene(lambda root: issue_to(root, "/new"), renew_list_in),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_it_is_wholly_done_or_not_at_all_whenever_the_kill_comes(place, prepared, scene):
    original = place / "original"
    shutil.copytree(prepared(BOTH), original, symlinks=True)
    scene.before(original)
    old = state_of(Keystore.open(original, to_change=True))
    outcomes = []
    for root, _ in copies(place, original, scene.work, every=scene.every):
        check_no_halves(root)
        found = state_of(Keystore.open(root, to_change=True))
        outcomes.append(found != old)
        if outcomes[-1] and old[0].keys() == found[0].keys() and found[0] != old[0]:
            assert not set(found[0].values()) & set(old[0].values()), "some renewed, some not"

        if not outcomes[-1]:  # a rerun completes
            scene.work(root)
            assert state_of(Keystore.open(root, to_change=True)) != old
        issue_to(root, "/next")
        assert drafts(root) == []
    check_commitment(outcomes, scene.every)


@pytest.mark.parametrize("name", ["renewed with new keys", "the first revocation"])
def test_a_disk_that_fails_at_any_call_is_no_worse_than_a_kill(place, prepared, name):
    scene, original = SCENES[name], prepared(BOTH)
    old = state_of(Keystore.open(original, to_change=True))
    for root, done in copies(place, original, scene.work, fails, every=25):
        found = state_of(Keystore.open(root, to_change=True))
        assert found != old or not done
        scene.work(root)
        assert state_of(Keystore.open(root, to_change=True)) != old
        assert drafts(root) == []


COMMANDS = ["renew --all", "renew --all --keep-key", "revoke /talker --yes", "issue /a /b /c"]


@pytest.mark.slow
@pytest.mark.parametrize("line", COMMANDS)
def test_a_process_that_is_killed_leaves_a_keystore_that_holds(place, prepared, line):
    for root in killed_processes(place, prepared(BOTH), line, within=0.02):
        found, listed, _ = state_of(Keystore.open(root, to_change=True))
        assert set(found) in ({*BOTH}, {*BOTH, "/a", "/b", "/c"})
        assert len(listed) <= 1


def test_a_renewal_that_fails_for_one_renews_nobody(place, prepared, monkeypatch):
    root = place / "keystore"
    shutil.copytree(prepared(BOTH), root, symlinks=True)
    old = state_of(Keystore.open(root, to_change=True))
    real = Renewer.make

    def failing(self, name, folder):
        if name == "/talker":
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(self, name, folder)

    monkeypatch.setattr(Renewer, "make", failing)
    with pytest.raises(FileError, match="no space left"):
        renew_in(root, *BOTH)
    monkeypatch.undo()
    assert state_of(Keystore.open(root, to_change=True)) == old
    assert drafts(root) == []


def test_a_mode_that_the_user_opened_or_narrowed_stays(place, prepared):
    root = place / "keystore"
    shutil.copytree(prepared(BOTH), root, symlinks=True)
    for mode in (0o755, 0o750, 0o500):
        (root / "enclaves/talker").chmod(mode)
        if mode == 0o500 and os.getuid() != 0:
            continue
        revoke_in(root, "/fleet/robot1")
        renew_in(root, "/talker")
        assert (root / "enclaves/talker").stat().st_mode & 0o777 == mode


@pytest.mark.parametrize("count", [2, 8])
def test_processes_that_issue_renew_and_revoke_at_once_lose_nothing(place, count):
    root = place / "keystore"
    create(root)
    issue_to(root, *(f"/old{number}" for number in range(count)))

    def life(number):
        issue_to(root, f"/new{number}")
        renew_in(root, f"/old{number}")
        revoke_in(root, f"/old{number}")

    assert at_once(*(lambda each=each: life(each) for each in range(count))) == [0] * count
    keystore = Keystore.open(root, to_change=True)
    _, listed, number = state_of(keystore)
    assert len(keystore.names()) == 2 * count
    # Both certificates of each: the one before the renewal had not expired.
    assert len(listed) == 2 * count
    assert number == count
    serials = [each.serial for each in keystore.ledger() if each.kind == "participant"]
    assert len(serials) == len(set(serials)) == 3 * count
    assert audit(keystore)[0] == len(keystore.ledger())


def test_a_kept_key_is_refused_where_the_profile_has_another_kind(place):
    root = place / "keystore"
    create(root)
    issue_to(root, "/talker")
    text = (root / "pqsec.json").read_text()
    (root / "pqsec.json").write_text(text.replace("ml-dsa-65", "ml-dsa-87"))
    keystore = Keystore.open(root, to_change=True)
    old = keystore.unlock(None)
    with pytest.raises(KeystoreError, match="are not of profile transition") as caught:
        renew(keystore, old, ["/talker"], Renewal(rekey=False), now=NOW + timedelta(days=1))
    assert caught.value.hint == "renew it with --rekey"
