"""A copy of a ledger in memory serves the next question, and never for other content."""

import os
import sqlite3
import threading
import time
from datetime import timedelta

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import (
    Entry,
    Keystore,
    _copies,
    _ledger,
    _ledger_file,
    _table,
    change,
    layout,
)
from pqsec_pki.keystore._copies import CopyKey
from pqsec_pki.keystore._file_store import FileStore
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._replaced_cas import refuse_replaced
from pqsec_pki.lifecycle import ParticipantSpec, PublicKeys, issue, revoke
from tests.unit.keystores import NOW, made


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical", names=())


@pytest.fixture
def reads(monkeypatch):
    """The times that a ledger's file is read."""
    found, load = [], _ledger_file.load

    def counted(private):
        found.append(private.path)
        return load(private)

    monkeypatch.setattr(_ledger_file, "load", counted)
    return found


def spec(name, key=None):
    keys = PublicKeys(key, None, request="0" * 64) if key else None
    validity = timedelta(days=90)
    return ParticipantSpec(name=name, domains=DomainSet.of(0), validity=validity, keys=keys)


def entry(number, name="/p"):
    return Entry(NOW.isoformat(), "receipt", name, None, f"{number:064x}", None)


def enter(keystore, number):
    with change(keystore.root) as transaction:
        transaction.record(entry(number))


def names(keystore):
    with keystore.open_ledger() as ledger:
        return [each.sha256 for each in ledger.of_kind("receipt")]


def test_what_is_done_in_one_hold_of_the_lock_reads_the_ledger_once(keystore, reads):
    """A change read it eight times: of 60,000 lines that took most of a server's time."""
    authorities = keystore.unlock(None)
    reads.clear()
    with keystore.hold():
        for name in ("/a", "/b"):
            issue(keystore, authorities, [spec(name)], now=NOW)
            assert keystore.elsewhere([name]) == []
            names(keystore)
    assert len(reads) <= 1


def test_lines_that_another_process_adds_are_seen_at_once(keystore, reads):
    enter(keystore, 1)
    for number in (2, 3):
        if child := os.fork():
            assert os.waitpid(child, 0)[1] == 0
        else:
            enter(Keystore.open(keystore.root, to_change=True), number)
            os._exit(0)
        assert names(keystore)[-1] == entry(number).sha256


def test_a_file_that_is_written_again_within_a_step_of_the_clock_is_read_again(
    keystore, monkeypatch
):
    """Its size and times are what they were."""
    enter(keystore, 1)
    now = time.time_ns() | 1
    monkeypatch.setattr(time, "time_ns", lambda: now)
    monkeypatch.setattr(_ledger_file, "version", lambda _: (1, 2, 3, now, now))
    path = keystore.root / layout.PRIVATE / layout.LEDGER
    for digit in "ef":
        assert names(keystore) != [digit * 64]
        data = path.read_bytes()
        path.write_bytes(data.replace(names(keystore)[0].encode(), digit.encode() * 64))
        assert names(keystore) == [digit * 64]


@pytest.fixture
def later(monkeypatch):
    """A clock by which all files were changed long ago, so that their times show each change."""
    now = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: now() + 10_000_000_000)


@pytest.mark.usefixtures("later")
def test_a_copy_is_for_no_other_keystore(keystore, tmp_path):
    """Or the revocations and tokens of one would be those of the other."""
    other = made(tmp_path / "other", "classical", names=())
    for number, each in enumerate((keystore, other)):
        enter(each, number)
    for number, each in enumerate((keystore, other)):
        assert names(each) == [entry(number).sha256]


@pytest.mark.usefixtures("later")
def test_a_copy_is_for_no_other_process(keystore, reads):
    """SQLite's connections are not for a fork."""
    names(keystore), names(keystore)
    before = len(reads)
    names(keystore)
    assert len(reads) == before
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0
    else:
        names(keystore)
        os._exit(len(reads) == before)


@pytest.mark.parametrize(
    ("changed", "moment", "shows"),
    [
        (1_000_000_001, 1_020_000_000, False),
        (1_000_000_001, 1_060_000_000, True),
        (1_000_000_000, 2_900_000_000, False),
        (1_000_000_000, 4_100_000_000, True),
        (0, 1, True),
    ],
)
def test_times_of_files_go_in_steps(changed, moment, shows):
    """Of 10 ms; or, where they are whole seconds, of up to two."""
    assert CopyKey("a", (1,), changed).shows_changes_after(moment) is shows


def test_a_copy_is_of_one_question_at_a_time(keystore):
    with keystore.hold(), keystore.open_ledger() as outer:
        with keystore.open_ledger() as inner:
            inner.append([entry(1)])
            assert len(inner.of_kind("receipt")) == 1
        assert outer.of_kind("receipt") == []
    assert names(keystore) == []


def test_lines_that_were_not_stored_are_in_no_later_copy(keystore, reads):
    with keystore.hold():
        for _ in range(2):
            with keystore.open_ledger() as ledger:
                ledger.append([entry(1)])
                ledger.append([entry(2)])
            assert names(keystore) == []
        with keystore.open_ledger() as ledger:
            ledger.append([entry(1)])
            assert ledger.to_file()
        assert names(keystore) == []


def test_a_closed_ledger_answers_nothing(keystore):
    """Its copy may serve somebody else by then."""
    with keystore.open_ledger() as ledger:
        pass
    ledger.close()
    with pytest.raises(RuntimeError, match="closed"):
        assert ledger.size


def test_each_thread_has_a_copy_of_its_own(keystore):
    names(keystore)
    found = []
    thread = threading.Thread(target=lambda: found.append(_copies._copies.kept))
    thread.start()
    thread.join()
    assert found == [None]


def test_the_copy_of_a_thread_that_has_ended_is_closed(keystore):
    """Python 3.13 warns of a database that is dropped open."""
    found = []

    def used():
        names(keystore)
        found.append(_copies._copies.kept.database)

    thread = threading.Thread(target=used)
    thread.start()
    thread.join()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        found[0].execute("SELECT 1")


def test_whether_the_cas_are_those_of_the_ledger_is_known_by_few_lines(keystore, monkeypatch):
    """With a ledger in PostgreSQL each change looked at all lines: 2 s of 60,000."""
    counted = []
    monkeypatch.setattr(
        _table, "entry", lambda row, make=_table.entry: counted.append(1) or make(row)
    )
    for number in range(20):
        enter(keystore, number)
    counted.clear()
    with Folder.opened(keystore.root) as root, root.below(layout.PRIVATE) as private:
        refuse_replaced(keystore.root, FileStore(private))
    assert len(counted) == len({"the identity CA", "the permissions CA"})


def test_a_key_of_another_is_found_among_the_lines_that_are_new(keystore):
    """The table of keys beside the copy grows with it, and loses what was not stored."""
    authorities = keystore.unlock(None)
    with keystore.hold():
        issue(keystore, authorities, [spec("/a"), spec("/b")], now=NOW)
        keys = [keystore.participant(name).key.public_key for name in ("/a", "/b")]
        for key, holder in zip(keys, ("/a", "/b"), strict=True):
            with pytest.raises(VerificationError, match=f"its key is that of {holder}"):
                issue(keystore, authorities, [spec("/c", key)], now=NOW)
        revoke(keystore, authorities, ["/a"], reason=Reason.SUPERSEDED, now=NOW)
        issue(keystore, authorities, [spec("/c", keys[0])], now=NOW)
        with pytest.raises(VerificationError, match="its key is that of /c"):
            issue(keystore, authorities, [spec("/d", keys[0])], now=NOW)


def test_only_new_lines_are_read_for_the_keys_that_they_certify(keystore):
    with keystore.open_ledger() as ledger:
        [(*_, plan)] = ledger._database.execute(f"EXPLAIN QUERY PLAN {_ledger._KEYS_AFTER}", (1,))
    assert plan.endswith("(rowid>?)")


def test_a_question_inside_another_reads_the_ledger_again_only_without_the_lock(keystore, reads):
    with keystore.hold(), keystore.open_ledger() as outer:
        reads.clear()
        with keystore.open_ledger() as inner:
            assert inner.head == outer.head
        assert not reads
    with keystore.open_ledger(), keystore.open_ledger():
        assert reads


@pytest.mark.usefixtures("later")
def test_a_copy_is_shared_no_longer_than_the_lock_is_held(keystore, reads):
    """Of a ledger in a database, lines that others add would come into an answer."""
    with keystore.hold():
        outer = keystore.open_ledger()
    reads.clear()
    with outer, keystore.open_ledger():
        assert reads


def test_a_change_inside_a_question_does_not_change_its_answer(keystore):
    with keystore.hold(), keystore.open_ledger() as outer:
        before, head = outer.size, outer.head
        enter(keystore, 1)
        assert (outer.size, outer.head) == (before, head)
        with keystore.open_ledger() as inner:
            assert inner.size == before + 1
            inner.append([entry(2)])
            assert names(keystore) == [entry(1).sha256]
        assert (outer.size, outer.head) == (before, head)
    assert names(keystore) == [entry(1).sha256]


def test_a_question_outlives_the_lock_it_was_asked_under(keystore):
    with keystore.hold():
        outer = keystore.open_ledger()
    enter(keystore, 1)
    with keystore.hold():
        assert names(keystore) == [entry(1).sha256]
    with outer:
        assert not outer.of_kind("receipt")
