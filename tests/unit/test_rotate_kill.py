"""A rollover, an adoption and a new passphrase survive a kill at any instant, and a full disk."""

import errno
import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from pqsec_pki.algorithms import is_encrypted, profile_named
from pqsec_pki.certificates import verify_chain
from pqsec_pki.errors import ExistsError
from pqsec_pki.keystore import Keystore, audit
from pqsec_pki.lifecycle import Rollover, Scope, adopt, change_passphrase
from pqsec_pki.smime import verify
from tests.unit import killing
from tests.unit.keystores import rotate
from tests.unit.killing import NOW, drafts, empty_list, fails_with, issue_to, survives, valid_at
from tests.unit.linting import check_nothing_broken
from tests.unit.sros2_keystore import SROS2

pytestmark = pytest.mark.usefixtures("links_count_too")

BOTH = ("/fleet/robot1", "/talker")
SECRET = b"secret"
RARELY = 5
"""What takes long is looked at after each so many calls, and a whole cycle is a hundred."""


def rotate_in(root, profile=None, *, scope=Scope.BOTH, destroy=False):
    keystore = Keystore.open(root, to_change=True)
    kept = keystore.unlock(None) if scope is not Scope.BOTH else None
    profile = profile_named(profile) if profile else keystore.profile
    terms = Rollover(profile=profile, scope=scope, destroy=destroy)
    return rotate(keystore, terms, kept=kept, passphrase=None, now=NOW)


def state_of(root):
    """All fingerprints, after everything was found to fit together."""
    keystore = Keystore.open(root, to_change=True)
    authorities = keystore.unlock(None)
    audit(keystore)
    twice = keystore.profile.alternative_key is not None
    found = [authorities.identity.certificate.der, authorities.permissions.certificate.der]
    for name in keystore.names():
        one = keystore.participant(name)
        assert one.key.public_key.spki == one.certificate.spki
        assert (one.alternative_key is not None) == twice
        now = valid_at(one.certificate)
        verify_chain(one.certificate, one.identity_ca, now=now, require_alternative=twice)
        for document in (one.permissions, one.governance):
            verified = verify(
                document,
                one.permissions_ca,
                alternative_ca=one.countersigner,
                require=keystore.anchors.required,
            )
        assert verified.document
        if one.revocation_list:
            one.revocation_list.verify(one.identity_ca)
        assert not [path for path in (root / f"enclaves{name}").iterdir() if not path.exists()]
        found.append(one.certificate.der)
    keys = {path.stat().st_mode & 0o777 for path in root.rglob("*key.pem")}
    assert keys == {0o600}
    return [hashlib.sha256(der).hexdigest() for der in found]


@dataclass(frozen=True)
class Scene:
    """Work on a keystore with /fleet/robot1 and /talker, prepared further by `before`."""

    work: Callable[[Path], object]
    before: Callable[[Path], object] = lambda _: None
    stays: int = 0
    """How many certificates stay as they are."""
    every: int = 25
    """Of how many calls one is killed."""


SCENES = {
    "both": Scene(rotate_in, empty_list, every=13),
    "old keys destroyed": Scene(lambda root: rotate_in(root, destroy=True)),
    "to pq": Scene(lambda root: rotate_in(root, "pq")),
    "from pq to transition": Scene(
        lambda root: rotate_in(root, "transition"), lambda root: rotate_in(root, "pq")
    ),
    "the identity CA": Scene(
        lambda root: rotate_in(root, scope=Scope.IDENTITY), empty_list, stays=1
    ),
    "the permissions CA": Scene(lambda root: rotate_in(root, scope=Scope.PERMISSIONS), stays=1),
}


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_the_generation_is_old_or_new_whenever_the_kill_comes(place, prepared, scene):
    original = place / "original"
    shutil.copytree(prepared(BOTH), original, symlinks=True)
    scene.before(original)
    old = state_of(original)
    outcomes = []
    for calls in killing.disturbed_calls(scene.every):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        done = survives(calls, lambda root=root: scene.work(root))
        found = state_of(root)
        outcomes.append(found != old)
        if outcomes[-1]:
            assert len(set(found) & set(old)) == scene.stays, "some of one generation, some not"
        if len(outcomes) % RARELY == 0:
            check_nothing_broken(root)
            scene.work(root)  # a rerun completes
            assert state_of(root) != old
            issue_to(root, "/next")
            assert drafts(root) == []
            check_nothing_broken(root)
        shutil.rmtree(root)
        if done:
            break
    assert len(outcomes) > 20 / scene.every
    # Not done, then from one call on done: the commitment is a single call.
    assert outcomes == sorted(outcomes)
    assert set(outcomes) == {False, True}


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_a_disk_that_fails_at_any_call_is_no_worse_than_a_kill(place, prepared, code):
    original = prepared(BOTH)
    old = state_of(original)
    for calls in killing.disturbed_calls(31 + (code == errno.EROFS)):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        done = fails_with(code, calls, lambda root=root: rotate_in(root, "pq", destroy=True))
        assert state_of(root) != old or not done
        rotate_in(root)
        assert state_of(root) != old
        assert drafts(root) == []
        shutil.rmtree(root)
        if done:
            break


def keys_in(root):
    """The old keys of the CAs, wherever they still are."""
    found = [path for path in root.rglob("*_ca*.key.pem") if path.is_file()]
    return {hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def test_old_keys_are_nowhere_once_a_killed_change_is_finished(place, prepared):
    original = prepared(BOTH)
    old = keys_in(original)
    committed = 0
    for calls in killing.disturbed_calls(13):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        names = {path: os.open(path, os.O_RDONLY) for path in (root / "private").glob("*.key.pem")}
        done = survives(calls, lambda root=root: rotate_in(root, destroy=True))
        Keystore.open(root, to_change=True)
        if not keys_in(root) & old:
            committed += 1
            # The files without a name hold zeros.
            assert {os.read(handle, 1 << 16).strip(b"\0") for handle in names.values()} == {b""}
        else:
            assert keys_in(root) >= old  # and new ones in a draft
        for handle in names.values():
            os.close(handle)
        shutil.rmtree(root)
        if done:
            break
    assert committed > 1


def test_the_passphrase_is_old_or_new_whenever_the_kill_comes(place, prepared):
    original = place / "original"
    shutil.copytree(prepared(()), original, symlinks=True)
    keystore = Keystore.open(original, to_change=True)
    authorities = keystore.unlock(None)
    change_passphrase(keystore, authorities, SECRET)
    outcomes = []
    for calls in killing.disturbed_calls(3):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        keystore = Keystore.open(root, to_change=True)
        # To remove it costs no hashes, and goes the same way as to set it.
        done = survives(calls, lambda k=keystore: change_passphrase(k, authorities, None))
        Keystore.open(root, to_change=True)
        states = {is_encrypted(path.read_bytes()) for path in root.glob("private/*.key.pem")}
        assert len(states) == 1, "some under the old, some under the new"
        outcomes.append(states == {False})
        shutil.rmtree(root)
        if done:
            break
    assert outcomes == sorted(outcomes)
    assert set(outcomes) == {False, True}


@pytest.mark.parametrize("with_list", [False, True])
def test_an_adoption_is_done_or_not_whenever_the_kill_comes(place, with_list):
    original = place / "original"
    sros2 = SROS2(original)
    for name in BOTH:
        (sros2.enclave(name) / "crl.pem").write_bytes(sros2.revoke(4711))
        if not with_list:
            (original / f"enclaves{name}/crl.pem").unlink()
    before = contents(original)
    outcomes = []
    for calls in killing.disturbed_calls(13 if with_list else 25):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        done = survives(calls, lambda root=root: adopt(root, now=NOW))
        try:
            adopt(root, now=NOW)
            outcomes.append(False)
        except ExistsError:
            outcomes.append(True)
        keystore = Keystore.open(root, to_change=True)
        audit(keystore)
        assert keystore.names() == sorted(BOTH)
        assert keystore.has_revocation_list == with_list
        after = contents(root)
        assert {path: after[path] for path in before} == before
        if len(outcomes) % 10 == 0:
            rotate_in(root, "pq")
            assert drafts(root) == []
            state_of(root)
        shutil.rmtree(root)
        if done:
            break
    assert outcomes == sorted(outcomes)
    assert set(outcomes) == {False, True}


def contents(root):
    files = [path for path in root.rglob("*.*") if path.is_file()]
    return {path.relative_to(root): path.read_bytes() for path in files}


COMMANDS = [
    "ca rotate --apply --yes --no-passphrase",
    "ca rotate --apply --yes --no-passphrase --profile pq --destroy-old-keys",
    "ca rotate --apply --yes --no-passphrase --only identity",
]


@pytest.mark.slow
@pytest.mark.parametrize("line", COMMANDS)
def test_a_process_that_is_killed_leaves_a_keystore_that_holds(place, prepared, line):
    for root in killing.killed_processes(place, prepared(BOTH), line, within=0.03):
        state_of(root)
        rotate_in(root)
        state_of(root)


def rotate_by_command(root):
    words = ["-k", str(root), "ca", "rotate", "--apply", "--yes", "--no-passphrase"]
    subprocess.run([sys.executable, "-m", "pqsec_pki", *words], check=True, capture_output=True)


@pytest.mark.parametrize("command", [False, True])
def test_two_rollovers_at_once_are_one_after_the_other(place, prepared, command):
    root = place / "keystore"
    shutil.copytree(prepared(BOTH), root, symlinks=True)
    rotate_one = rotate_by_command if command else rotate_in
    assert killing.at_once(*[lambda: rotate_one(root)] * 2) == [0, 0]
    state_of(root)
    assert sorted(path.name for path in (root / "private/generations").iterdir()) == ["1", "2"]


def test_who_issues_while_cas_are_rotated_does_so_with_the_new_or_not_at_all(place, prepared):
    root = place / "keystore"
    shutil.copytree(prepared(BOTH), root, symlinks=True)
    codes = killing.at_once(
        lambda: rotate_in(root), *(lambda n=n: issue_to(root, f"/n{n}") for n in range(3))
    )
    assert codes[0] == 0
    state_of(root)
