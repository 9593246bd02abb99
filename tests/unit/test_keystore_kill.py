"""A keystore survives a kill at any instant: old or new, never a mix.

A child process does the work and is killed at its Nth call to the operating system, for
every N until the work is done; writes are cut in half. Then the parent looks.
"""

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from pqsec_pki.errors import ExistsError
from pqsec_pki.keystore import Keystore
from tests.unit.killing import (
    at_once,
    check_commitment,
    check_ledger,
    check_no_halves,
    check_whole,
    copies,
    create,
    disturbed_calls,
    drafts,
    fails,
    is_keystore,
    issue_to,
    survives,
)

# What is done while the kill comes


@dataclass(frozen=True)
class Scene:
    """Work on a keystore that has the participants `before`; all of `after` then."""

    before: tuple[str, ...]
    work: Callable[[Path], object]
    after: tuple[str, ...]
    replaced: tuple[str, ...] = ()
    every: int = 25
    """Of how many calls one is killed."""


SCENES = {
    "first issue": Scene((), lambda root: issue_to(root, "/talker"), ("/talker",)),
    "nested": Scene(
        (), lambda root: issue_to(root, "/fleet", "/fleet/robot1"), ("/fleet", "/fleet/robot1")
    ),
    "the outer beside the inner": Scene(
        ("/fleet/robot1",), lambda root: issue_to(root, "/fleet"), ("/fleet", "/fleet/robot1")
    ),
    "forced": Scene(
        ("/talker",),
        lambda root: issue_to(root, "/talker", force=True),
        ("/talker",),
        replaced=("/talker",),
        every=1,
    ),
    "some forced, some new": Scene(
        ("/fleet", "/fleet/robot1"),
        lambda root: issue_to(root, "/fleet", "/new", force=True),
        ("/fleet", "/fleet/robot1", "/new"),
        replaced=("/fleet",),
    ),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_participants_are_all_issued_or_none_whenever_the_kill_comes(place, prepared, scene):
    original = prepared(scene.before)
    old = {
        name: check_whole(Keystore.open(original, to_change=True), name) for name in scene.before
    }
    outcomes = []
    for root, _ in copies(place, original, scene.work, every=scene.every):
        check_no_halves(root)
        keystore = Keystore.open(root, to_change=True)
        names = tuple(keystore.names())
        assert names in {scene.before, scene.after}
        found = {name: check_whole(keystore, name) for name in names}
        check_ledger(keystore)
        new = {name for name in scene.replaced if found[name] != old[name]}
        assert new in (set(), set(scene.replaced))
        committed = names != scene.before or bool(new)
        kept = set(scene.before) - new
        assert all(found[name] == old[name] for name in kept)
        outcomes.append(committed)

        issue_to(root, "/next")
        check_whole(keystore, "/next")
        check_ledger(keystore)
        assert drafts(root) == []
    check_commitment(outcomes, scene.every)


def test_a_keystore_is_made_or_not_whenever_the_kill_comes(place):
    outcomes = []
    for calls in disturbed_calls(5):
        root = place / str(calls)
        done = survives(calls, lambda root=root: create(root))
        outcomes.append(is_keystore(root))
        if outcomes[-1]:
            with pytest.raises(ExistsError):
                create(root)
        keystore = Keystore.open(root, to_change=True) if outcomes[-1] else create(root)
        assert keystore.names() == []
        check_ledger(keystore)
        keys = list((root / "private").glob("*.key.pem"))
        assert len(keys) == 4
        assert {key.stat().st_mode & 0o777 for key in keys} == {0o600}
        issue_to(root, "/talker")
        check_whole(keystore, "/talker")
        check_ledger(keystore)
        assert drafts(root) == []
        shutil.rmtree(root)
        if done:
            break
    check_commitment(outcomes, 5)


def test_a_keystore_can_be_made_again_without_being_opened_after_a_kill(place):
    for calls in disturbed_calls(9):
        root = place / str(calls)
        if survives(calls, lambda root=root: create(root)):
            break
        try:
            create(root)
        except ExistsError:
            Keystore.open(root, to_change=True)
        check_ledger(Keystore.open(root, to_change=True))
        shutil.rmtree(root)


@pytest.mark.slow
def test_a_recovery_that_is_killed_too_is_finished_by_the_next(place, prepared):
    original = place / "committed"
    shutil.copytree(prepared(("/old",)), original, symlinks=True)
    calls = 1
    while not (original / ".journal").is_dir():
        survives(calls, lambda: issue_to(original, "/old", "/a", force=True))
        calls += 1
    count = 0
    for root, _ in copies(place, original, Keystore.recover, every=5):
        keystore = Keystore.open(root, to_change=True)
        assert keystore.names() == ["/a", "/old"]
        for name in keystore.names():
            check_whole(keystore, name)
        check_ledger(keystore)
        count += 1
    assert count > 10 / 5


def test_a_disk_that_fails_at_any_call_is_no_worse_than_a_kill(place, prepared):
    original = prepared(("/old",))
    old = check_whole(Keystore.open(original, to_change=True), "/old")

    def again(root):
        issue_to(root, "/old", force=True)

    for root, done in copies(place, original, again, fails, every=20):
        keystore = Keystore.open(root, to_change=True)
        found = check_whole(keystore, "/old")
        check_ledger(keystore)
        assert done or found == old or len(keystore.ledger()) == 4 + 2 * 2
        issue_to(root, "/next")
        assert drafts(root) == []


# Two at once


def test_two_processes_issue_at_the_same_time(place):
    root = place / "keystore"
    create(root)
    names = [[f"/{who}{number}" for number in range(20)] for who in ("a", "b")]
    codes = at_once(*(lambda each=each: [issue_to(root, name) for name in each] for each in names))
    assert codes == [0, 0]
    keystore = Keystore.open(root, to_change=True)
    assert keystore.names() == sorted(names[0] + names[1])
    for name in keystore.names():
        check_whole(keystore, name)
    check_ledger(keystore)
    serials = [entry.serial for entry in keystore.ledger() if entry.serial]
    assert len(serials) == len(set(serials)) == 3 + 40
    assert drafts(root) == []


def test_two_processes_that_want_the_same_name_do_not_both_get_it(place):
    root = place / "keystore"
    create(root)
    for _ in range(5):
        shutil.rmtree(root / "enclaves/talker", ignore_errors=True)
        codes = at_once(*[lambda: issue_to(root, "/talker")] * 2)
        assert sorted(codes) == [0, 3]
        check_whole(Keystore.open(root, to_change=True), "/talker")


@pytest.mark.slow
def test_a_recovery_that_takes_in_what_an_earlier_pqsec_left_may_be_killed_too(place, prepared):
    """Lines that it had in the ledger's -wal, of which nothing is lost or taken in twice."""
    original = place / "committed"
    shutil.copytree(prepared(("/old",)), original, symlinks=True)
    leave_a_table_in_the_wal(original / "private/ledger.sqlite3")
    calls = 1
    while not (original / ".journal").is_dir():
        survives(calls, lambda: issue_to(original, "/a"))
        calls += 1
    assert (original / "private/ledger.sqlite3-wal").stat().st_size > 0
    count = 0
    for root, _ in copies(place, original, Keystore.recover, every=5):
        Keystore.recover(root)
        check_ledger(Keystore.open(root))
        with closing(sqlite3.connect(root / "private/ledger.sqlite3")) as database:
            assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert database.execute("SELECT number FROM another").fetchall() == [(5,)]
        assert not list((root / "private").glob("ledger.sqlite3-*"))
        count += 1
    assert count > 10 / 5


def leave_a_table_in_the_wal(ledger):
    """Where SQLite writes it first; as a process leaves it that is killed."""
    aside = ledger.parents[2] / "aside"
    with closing(sqlite3.connect(ledger, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("CREATE TABLE another (number INTEGER)")
        database.execute("INSERT INTO another VALUES (5)")
        shutil.copytree(ledger.parent, aside)
    for path in aside.glob("ledger.sqlite3*"):
        path.replace(ledger.with_name(path.name))
    ledger.with_name("ledger.sqlite3-shm").unlink()
