"""Who changes a keystore that somebody prepared, or alters meanwhile, changes nothing beside it."""

import json
import os
import shlex
import shutil
from contextlib import suppress
from pathlib import Path

import pytest

from pqsec_pki.errors import InterruptedChangeError, KeystoreError, PqsecError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import change_passphrase, revoke
from tests.unit.killing import CALLS, NOW, disturbed_calls, fork, issue_to

NOBODY = 65534
ROBOT = "/fleet/robot"
LINE = ["2026-11-21T12:00:00+00:00", "permissions", "x.p7s", None, "0" * 64, None]
superuser = pytest.mark.skipif(os.geteuid() != 0, reason="another user can be tried by root only")


@pytest.fixture
def root(place, prepared):
    """A keystore, with a canary beside it."""
    (place / "canary").mkdir()
    (place / "canary/file").write_bytes(b"precious")
    return Path(shutil.copytree(prepared((ROBOT,)), place / "k", symlinks=True))


def canary(root):
    """What is in it."""
    found = sorted(root.with_name("canary").rglob("*"))
    return [(path.name, path.is_file() and path.read_bytes()) for path in found]


def interrupted(root, **moves):
    """A change as a command leaves it that was killed after its commitment."""
    (root / ".journal/0").mkdir(parents=True)
    (root / ".journal/0/cert.pem").write_bytes(b"x")
    moves = {"targets": ["enclaves/fleet/new"], "entries": [LINE]} | moves
    (root / ".journal/moves.json").write_text(json.dumps(moves))


def revoke_in(root):
    keystore = Keystore.open(root, to_change=True)
    revoke(keystore, keystore.unlock(None), [ROBOT], now=NOW)


def passphrase_in(root):
    keystore = Keystore.open(root, to_change=True)
    change_passphrase(keystore, keystore.unlock(None), None)


CHANGES = {
    "issue": lambda root: issue_to(root, "/fleet/other"),
    "issue again": lambda root: issue_to(root, ROBOT, force=True),
    "revoke": revoke_in,
    "passphrase": passphrase_in,
    "recover": Keystore.recover,
}


def link_for(place):
    """The canary takes its place."""

    def plant(root):
        path = root / place
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.symlink_to(root.with_name("canary"))

    return plant


def link_to_a_file(place):
    def plant(root):
        (root / place).unlink(missing_ok=True)
        (root / place).symlink_to(root.with_name("canary") / "file")

    return plant


def spent_link(root):
    interrupted(root)
    (root / ".journal/spent").symlink_to(root.with_name("canary"))


def spent_file(root):
    """A hard link and a link to the canary, in the journal's own folder."""
    interrupted(root)
    (root / ".journal/spent").mkdir()
    (root / ".journal/spent/link").symlink_to(root.with_name("canary") / "file")
    (root / ".journal/spent/hard").hardlink_to(root.with_name("canary") / "file")


def moves_link(root):
    interrupted(root)
    (root / ".journal/moves.json").rename(root.with_name("moves.json"))
    (root / ".journal/moves.json").symlink_to(root.with_name("moves.json"))


def with_journal(plant):
    def both(root):
        interrupted(root)
        plant(root)

    return both


PLACES = ("private", "public", "enclaves", "enclaves/fleet", f"enclaves{ROBOT}", ".journal/0")
FILES = (*(f"private/ledger.sqlite3{each}" for each in ("", "-wal", "-shm", "-journal")),)
PLANTED = {
    ".journal/spent": spent_link,
    "files in .journal/spent": spent_file,
    ".journal/moves.json": moves_link,
    ".journal": link_for(".journal"),
    ".draft-x": link_for(".draft-0123456789abcdef"),
    "private/generations": link_for("private/generations"),
    "the key": link_to_a_file(f"enclaves{ROBOT}/key.pem"),
    "the CA key": link_to_a_file("private/identity_ca.key.pem"),
    **{each: link_for(each) for each in PLACES[:-1]},
    **{f"{each}, interrupted": with_journal(link_for(each)) for each in PLACES},
    **{each: link_to_a_file(each) for each in FILES},
    **{f"{each}, interrupted": with_journal(link_to_a_file(each)) for each in FILES},
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_change_goes_through_no_link_that_lies_there(root, change):
    before, original, found = canary(root), root.with_name("original"), []
    root.rename(original)
    for words, plant in PLANTED.items():
        shutil.copytree(original, root, symlinks=True)
        plant(root)
        with suppress(PqsecError):
            change(root)
        if canary(root) != before:
            found.append(words)
        shutil.rmtree(root)
    assert found == []


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("where", [*PLACES, ".journal", ".journal/spent", "private/ledger.sqlite3"])
@pytest.mark.parametrize("change", ["issue again", "recover"])
def test_a_change_goes_through_no_link_that_takes_a_folders_place_meanwhile(root, change, where):
    """Put there before each of its calls to the system in turn; in the gate before some."""
    every = 9 if change == "issue again" else 3
    if change == "recover":
        interrupted(root, targets=["enclaves/fleet/robot", "enclaves/fleet/new"])
        (root / ".journal/1").mkdir()
        (root / ".journal/spent").mkdir()
        (root / ".journal/spent/key.pem").write_bytes(b"old")
    before, original, found = canary(root), root.with_name("original"), []
    root.rename(original)
    for calls in disturbed_calls(every):
        shutil.copytree(original, root, symlinks=True)
        done = swapped_at(calls, lambda: CHANGES[change](root), lambda: swap(root, where))
        shutil.rmtree(f"{root}.aside", ignore_errors=True)
        if canary(root) != before:
            found.append(calls)
        shutil.rmtree(root)
        if done:
            break
    assert calls > 5 * every
    assert found == []


def swap(root, where):
    path = root / where
    if os.path.lexists(path):
        path.rename(f"{root}.aside")
        path.symlink_to(root.with_name("canary"))


def swapped_at(calls, work, swap):
    """Whether `work` is done, or has failed by an error of ours, before its Nth call."""
    child = fork()
    if child == 0:
        left = [calls]
        for name in (*CALLS, "link", "listdir", "scandir", "stat", "lstat", "fsync"):
            watch(name, left, swap)
        try:
            with suppress(PqsecError):
                work()
        except BaseException:  # noqa: BLE001 -- the parent wants to know of any
            os._exit(1)
        os._exit(0 if left[0] > 0 else 2)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code != 1, "another error than ours"
    return code == 0


def watch(name, left, swap):
    real = getattr(os, name)

    def watched(*arguments, **options):
        left[0] -= 1
        if left[0] == 0:
            swap()
        return real(*arguments, **options)

    setattr(os, name, watched)


# What a reader says


def test_who_reads_is_told_that_a_change_was_interrupted_and_what_finishes_it(root):
    interrupted(root)
    with pytest.raises(InterruptedChangeError, match="a change was interrupted") as refused:
        Keystore.open(root)
    assert refused.value.hint == f"`pqsec -k {root} ca recover` finishes it"
    assert Keystore.recover(root)
    assert not Keystore.recover(root)
    assert Keystore.open(root).ledger()[-1].name == "x.p7s"


def test_the_name_of_a_keystore_is_no_part_of_a_command_that_people_paste(root):
    """Whoever made the folder chose what root's shell runs."""
    interrupted(root)
    hostile = root.rename(root.with_name("k;touch own"))
    with pytest.raises(InterruptedChangeError) as refused:
        Keystore.open(hostile)
    command = refused.value.hint.split("`")[1]
    assert shlex.split(command) == ["pqsec", "-k", str(hostile), "ca", "recover"]
    hostile.chmod(0o777)
    with pytest.raises(KeystoreError) as refused:
        Keystore.recover(hostile)
    assert shlex.split(refused.value.hint)[:3] == ["chmod", "go-w", str(hostile)]


@pytest.mark.parametrize("target", ["../../../../outside", "/outside", "a/../../../../../x"])
def test_a_journal_makes_no_link_that_leads_out_of_the_keystore(root, target):
    interrupted(root, links=[["enclaves/fleet/robot/crl.pem", target]])
    with pytest.raises(KeystoreError, match="this unfinished change cannot be read"):
        Keystore.recover(root)
    assert not (root / "enclaves/fleet/robot/crl.pem").is_symlink()


# Whose it is, and who else may write there


@pytest.mark.parametrize("where", ["", "private", "private/ledger.sqlite3", ".journal"])
@pytest.mark.parametrize("mode", [0o772, 0o720])
def test_nothing_is_changed_where_others_may_write(root, where, mode):
    if where == ".journal":
        interrupted(root)
    (root / where).chmod(mode)
    os.chown(root / where, -1, other_group())
    for change in (CHANGES["issue"], CHANGES["recover"]):
        if where.startswith("private") and change is Keystore.recover:
            continue  # nothing was interrupted
        with pytest.raises(KeystoreError, match="may write there") as refused:
            change(root)
        assert refused.value.hint == f"chmod go-w {root / where}".rstrip("/")


def other_group():
    """One that is nobody's own, if we may give files to it; else one of ours."""
    return NOBODY if os.geteuid() == 0 else os.getgroups()[0]


@superuser
@pytest.mark.parametrize("where", ["", "private", "private/ledger.sqlite3", ".journal"])
def test_the_superuser_changes_nothing_in_a_keystore_of_another_user(root, where):
    interrupted(root)
    os.chown(root / where, NOBODY, NOBODY)
    with pytest.raises(
        KeystoreError,
        match=r"it belongs to another user \(nobody\); anyone who may write there can",
    ) as refused:
        Keystore.recover(root)
    assert "sudo -u nobody pqsec" in refused.value.hint
    assert (root / ".journal").exists()
