"""The ledger: what it keeps, what shows when it is altered, and what an older one becomes."""

import hashlib
import json
import os
import resource
import shutil
import sqlite3
from contextlib import closing, suppress
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki import _owners
from pqsec_pki.errors import FileError, KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import Entry, Keystore, _file_store, _journal, audit, status
from pqsec_pki.keystore._chain import START
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.lifecycle import renew, revoke
from tests.unit.keystores import DAY, NOW, add, enter, made
from tests.unit.killing import at_once

FORMAT_1 = """
CREATE TABLE issued (
    id INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    kind TEXT NOT NULL,
    name TEXT NOT NULL,
    serial TEXT UNIQUE,
    sha256 TEXT NOT NULL UNIQUE,
    not_after TEXT
) STRICT;
CREATE INDEX issued_name ON issued (name);
CREATE TRIGGER issued_stays BEFORE UPDATE ON issued
    BEGIN SELECT RAISE (ABORT, 'lines are only added'); END;
CREATE TRIGGER issued_remains BEFORE DELETE ON issued
    BEGIN SELECT RAISE (ABORT, 'lines are only added'); END;
"""
"""As pqsec made it before there was a chain."""


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def database(keystore):
    return closing(sqlite3.connect(keystore.root / "private/ledger.sqlite3", isolation_level=None))


def forget_head(keystore):
    """Without it the ledger is compared with nothing: what else finds the flaw is tested."""
    (keystore.root / "public/ledger.checkpoint").unlink()


def alter(keystore, *statements):
    """What somebody does who can write the file and knows SQL."""
    with database(keystore) as opened:
        for name in ("ledger_stays", "ledger_remains"):
            opened.execute(f"DROP TRIGGER IF EXISTS {name}")
        for statement in statements:
            opened.execute(statement)


def entry(number, **changes):
    given = Entry(
        at="2026-11-21T12:00:00+00:00",
        kind="participant",
        name=f"/p{number}",
        serial=f"{number:x}",
        sha256=f"{number:064x}",
        not_after="2027-11-21T12:00:00+00:00",
        issuer="ca",
        details={"domains": "0"},
        operator="me",
    )
    return replace(given, **changes)


# What it keeps


def test_a_participants_line_tells_who_what_when_where_and_by_whom(keystore):
    line = next(each for each in keystore.ledger() if each.name == "/talker")
    certificate = keystore.participant("/talker").certificate
    assert line.kind == "participant"
    assert line.serial == f"{certificate.serial_number:x}"
    assert line.issuer == keystore.identity_ca.fingerprint
    keys = hashlib.sha256(certificate.public_key.raw).hexdigest()
    assert line.details == {"profile": "classical", "domains": "0", "keys": keys}
    assert line.made_at == NOW
    assert line.ends == certificate.not_after
    assert line.operator


def test_a_user_whom_the_system_does_not_name_is_a_number(keystore, monkeypatch):
    def unknown(uid):
        raise KeyError(uid)

    _owners.user.cache_clear()
    monkeypatch.setattr(_owners.pwd, "getpwuid", unknown)
    add(keystore, later="0")
    _owners.user.cache_clear()
    assert keystore.ledger()[-1].operator == f"uid {os.getuid()}"


def test_the_name_for_the_ledger_can_be_chosen(keystore, monkeypatch):
    monkeypatch.setenv("PQSEC_OPERATOR", "officer 7")
    add(keystore, later="0")
    assert keystore.ledger()[-1].operator == "officer 7"
    for bad in ("x" * 65, "a\nb", "a\x1bb"):
        monkeypatch.setenv("PQSEC_OPERATOR", bad)
        with pytest.raises(UsageError, match="PQSEC_OPERATOR is not a name"):
            add(keystore, last="0")
    assert not keystore.has("/last")


def test_each_line_names_the_one_before(keystore):
    lines = keystore.lines()
    assert [line.number for line in lines] == list(range(1, len(lines) + 1))
    assert len({line.chain for line in lines}) == len(lines)
    assert audit(keystore) == (len(lines), lines[-1].chain)


def test_a_line_that_is_there_already_is_not_added_again(keystore):
    before = len(keystore.lines())
    enter(keystore, [entry(1), entry(2), entry(1)])
    enter(keystore, [entry(2), entry(3)])
    assert [line.entry for line in keystore.lines()[before:]] == [entry(1), entry(2), entry(3)]
    audit(keystore)


def test_one_ca_gives_a_serial_number_once_only(keystore):
    enter(keystore, [entry(1)])
    with keystore.open_ledger() as ledger, pytest.raises(KeystoreError, match="UNIQUE"):
        ledger.append([entry(2), entry(3, serial="1")])
    enter(keystore, [entry(4, serial="1", issuer="another")])
    assert [each.name for each in keystore.ledger()][-2:] == ["/p1", "/p4"]


@pytest.mark.parametrize("text", ["\ud800", "a\0b", "'; DROP TABLE ledger; --", "é" * 1000])
def test_any_text_can_be_entered_or_is_refused(keystore, text):
    with keystore.open_ledger() as ledger, suppress(KeystoreError):
        ledger.append([entry(1, name=text)])
        assert ledger.of_name("participant", text) == [entry(1, name=text)]
    audit(keystore)


# What shows


ALTERATIONS = {
    "a name": ("UPDATE ledger SET name = '/evil' WHERE number = 5", "line 5 was altered"),
    "a time": ("UPDATE ledger SET at = '2020-01-01' WHERE number = 1", "line 1 was altered"),
    "an operator": ("UPDATE ledger SET operator = NULL WHERE number = 2", "line 2 was altered"),
    "an issuer": ("UPDATE ledger SET issuer = 'x' WHERE number = 4", "line 4 was altered"),
    "details": (
        """UPDATE ledger SET details = '{"domains":"0-230"}' WHERE number = 4""",
        "line 4 was altered",
    ),
    "details that are none": (
        "UPDATE ledger SET details = '{' WHERE number = 4",
        "line 4 was altered",
    ),
    "details of another kind": (
        "UPDATE ledger SET details = '[]' WHERE number = 3",
        "line 3 was altered",
    ),
    "a serial": ("UPDATE ledger SET serial = '1' WHERE number = 6", "line 6 was altered"),
    "details that SQLite reads otherwise": (
        """UPDATE ledger SET details = '{"domains":"0-230",' || substr(details, 2)
            WHERE number = 4""",
        "line 4 was altered",
    ),
    "a kind": ("UPDATE ledger SET kind = 'crl' WHERE number = 5", "line 5 was altered"),
    "an end": ("UPDATE ledger SET not_after = '2099-01-01' WHERE number = 4", "line 4 was altered"),
    "a hash": ("UPDATE ledger SET sha256 = 'x' WHERE number = 4", "line 4 was altered"),
    "a chain value": (
        "UPDATE ledger SET chain = 'x' WHERE number = 5",
        "line 5 was altered or replaced",
    ),
    "a line removed": ("DELETE FROM ledger WHERE number = 3", "line 3 is missing"),
    "lines removed": ("DELETE FROM ledger WHERE number IN (2, 3)", "lines 2 to 3 are missing"),
    "the first line removed": ("DELETE FROM ledger WHERE number = 1", "line 1 is missing"),
}


@pytest.mark.parametrize(("statement", "words"), ALTERATIONS.values(), ids=ALTERATIONS)
def test_an_alteration_shows(keystore, statement, words):
    audit(keystore)
    alter(keystore, statement)
    with pytest.raises(VerificationError) as refusal:
        audit(keystore)
    assert any(problem.startswith(words) for problem in refusal.value.lines)


def test_lines_that_changed_places_show(keystore):
    alter(
        keystore,
        "UPDATE ledger SET number = -4 WHERE number = 4",
        "UPDATE ledger SET number = 4 WHERE number = 6",
        "UPDATE ledger SET number = 6 WHERE number = -4",
    )
    with pytest.raises(VerificationError) as refusal:
        audit(keystore)
    places = [problem.split(" was")[0] for problem in refusal.value.lines]
    assert places == ["line 4", "line 5", "line 6", "line 7"]


def test_a_line_removed_and_the_others_moved_up_shows(keystore):
    alter(
        keystore,
        "DELETE FROM ledger WHERE number = 4",
        "UPDATE ledger SET number = number - 1 WHERE number > 4",
    )
    with pytest.raises(VerificationError, match="line 4 was altered or replaced"):
        audit(keystore)


def test_the_newest_lines_missing_show_by_what_lies_in_the_keystore(keystore):
    alter(keystore, "DELETE FROM ledger WHERE number > 5")
    with pytest.raises(VerificationError) as refusal:
        audit(keystore)
    *files, head = [problem.split(" is not in the ledger")[0] for problem in refusal.value.lines]
    found = {file.rpartition("/")[2] for file in files}
    assert found == {"cert.pem", "permissions.p7s"}
    assert "ledger.checkpoint: the end was cut off" in head


def test_a_ledger_written_anew_shows_by_a_head_that_was_noted(keystore):
    _, head = audit(keystore)
    add(keystore, later="0")
    audit(keystore, head)
    audit(keystore, head.upper())
    audit(keystore, START)
    entries = keystore.ledger()
    for file in keystore.root.glob("p*/ledger*"):  # and the signed head
        file.unlink()
    # By who can write it: the same, but for one thing in each line.
    with Folder.opened(keystore.root / "private") as private:
        others = [replace(each, operator="nobody") for each in entries]
        _file_store.add(private, others, private, begin=True)
    audit(keystore)
    with pytest.raises(VerificationError, match="the head is not in the ledger"):
        audit(keystore, head)


def test_a_second_certificate_behind_a_participants_own_shows(keystore, tmp_path):
    path = keystore.root / "enclaves/talker/cert.pem"
    other = made(tmp_path / "other", "classical").root / "enclaves/talker/cert.pem"
    path.write_bytes(path.read_bytes() + other.read_bytes())
    with pytest.raises(VerificationError, match=r"talker/cert\.pem is not in the ledger"):
        audit(keystore)


@pytest.mark.parametrize("file", ["cert.pem", "permissions.p7s"])
def test_what_was_never_issued_here_shows(keystore, tmp_path, file):
    other = made(tmp_path / "other", "classical")
    data = (other.root / "enclaves/talker" / file).read_bytes()
    path = keystore.root / "enclaves/talker" / file
    path.write_bytes(data)
    with pytest.raises(VerificationError) as refusal:
        audit(keystore)
    assert refusal.value.lines == (f"{path} is not in the ledger",)


def test_a_certificate_in_the_folder_of_another_shows(keystore):
    folder = keystore.root / "enclaves"
    shutil.copy(folder / "listener/cert.pem", folder / "talker/cert.pem")
    with pytest.raises(VerificationError, match=r"talker/cert\.pem is not in the ledger"):
        audit(keystore)


def test_signed_permissions_in_the_place_of_the_governance_show(keystore):
    folder = keystore.root / "enclaves"
    shutil.copy(folder / "talker/permissions.p7s", folder / "governance.p7s")
    with pytest.raises(VerificationError, match=r"governance\.p7s is not in the ledger"):
        audit(keystore)


def test_an_older_revocation_list_put_back_shows(keystore):
    authorities = keystore.unlock(None)
    revoke(keystore, authorities, ["/listener"], now=NOW)
    older = keystore.revocation_list_path.read_bytes()
    revoke(keystore, authorities, ["/talker"], now=NOW)
    audit(keystore)
    keystore.revocation_list_path.write_bytes(older)
    with pytest.raises(VerificationError, match="is not the newest list in the ledger"):
        audit(keystore)


def test_a_damaged_certificate_shows(keystore):
    path = keystore.root / "enclaves/talker/cert.pem"
    path.write_bytes(b"broken")
    with pytest.raises(VerificationError, match=r"cert\.pem"):
        audit(keystore)


def test_a_damaged_line_is_no_traceback_elsewhere(keystore):
    statement = "UPDATE ledger SET not_after = 'never', serial = 'x' WHERE name = '/talker'"
    for work in (
        lambda: status(keystore, now=NOW),
        lambda: revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW),
    ):
        alter(keystore, statement)
        with pytest.raises(KeystoreError, match="the ledger's line on participant /talker is dam"):
            work()


def test_permissions_of_a_participant_without_any_line_are_not_renewed(keystore):
    forget_head(keystore)
    alter(keystore, "DELETE FROM ledger WHERE kind = 'permissions' AND name = '/talker'")
    with pytest.raises(KeystoreError, match=r"permissions\.p7s is not the newest"):
        renew(keystore, keystore.unlock(None), ["/talker"], now=NOW)


# An older one


def older(keystore):
    """The same ledger in format 1."""
    rows = [(e.at, e.kind, e.name, e.serial, e.sha256, e.not_after) for e in keystore.ledger()]
    for file in keystore.root.glob("p*/ledger*"):  # and the signed head
        file.unlink()
    with database(keystore) as opened:
        opened.executescript(FORMAT_1)
        opened.executemany(
            "INSERT INTO issued (at, kind, name, serial, sha256, not_after)"
            " VALUES (?, ?, ?, ?, ?, ?)",
            rows,
        )
    return rows


def test_an_older_ledger_is_brought_up_to_date_with_nothing_lost(keystore):
    rows = older(keystore)
    found = Keystore.open(keystore.root).ledger()
    assert [(e.at, e.kind, e.name, e.serial, e.sha256, e.not_after) for e in found] == rows
    assert {each.operator for each in found} == {None}
    issuers = {each.issuer for each in found if each.kind == "participant"}
    assert issuers == {keystore.identity_ca.fingerprint}
    audit(keystore)
    assert tables(keystore) == {"issued"}  # who reads changes nothing
    add(keystore, later="0")
    assert tables(keystore) == {"ledger"}
    assert len(keystore.ledger()) == len(rows) + 2


def tables(keystore):
    with database(keystore) as opened:
        found = opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    return {name for (name,) in found} - {"sqlite_sequence"}


def test_what_an_older_ledger_has_can_be_renewed_and_revoked(keystore):
    older(keystore)
    authorities = keystore.unlock(None)
    assert {each.domains for each in status(keystore, now=NOW).participants} == {None}
    renew(keystore, authorities, ["/talker"], now=NOW + DAY)
    revoked, crl = revoke(keystore, authorities, ["/talker"], now=NOW + DAY)
    assert len(revoked) == len(crl.revoked) == 2
    audit(keystore)


def test_several_who_find_an_older_ledger_bring_it_up_to_date_once(keystore):
    rows = older(keystore)
    work = lambda: Keystore.open(keystore.root).ledger()  # noqa: E731
    assert at_once(*[work] * 4) == [0] * 4
    assert len(keystore.ledger()) == len(rows)
    audit(keystore)


def unfinished(keystore):
    """A change as a command leaves it that was killed after its commitment."""
    (keystore.root / ".journal").mkdir()
    line = ["2026-11-21T12:00:00+00:00", "permissions", "x.p7s", None, "0" * 64, None]
    moves = {"targets": [], "entries": [line]}
    (keystore.root / ".journal/moves.json").write_text(json.dumps(moves))


def test_a_change_that_an_older_pqsec_left_unfinished_is_finished(keystore):
    unfinished(keystore)
    assert Keystore.open(keystore.root, to_change=True).ledger()[-1].name == "x.p7s"


def test_a_newer_ledger_is_refused(keystore):
    with database(keystore) as opened:
        opened.execute("PRAGMA user_version = 3")
    with pytest.raises(KeystoreError, match="made by another version of pqsec"):
        keystore.ledger()


# Who may


HOSTILE_TABLES = {
    "a view without an end": (
        "ALTER TABLE ledger RENAME TO old",
        (
            "CREATE VIEW ledger AS WITH RECURSIVE r AS (SELECT 0 AS number, '' AS at, 'x' AS kind,"
            " '' AS name, '' AS serial, '' AS sha256, '' AS not_after, '' AS issuer,"
            " '{}' AS details, '' AS operator, '' AS chain UNION ALL SELECT number + 1, at, kind,"
            " name, serial, sha256, not_after, issuer, details, operator, chain FROM r)"
            " SELECT * FROM r"
        ),
    ),
    "a trigger that leaves lines out": (
        (
            "CREATE TRIGGER more BEFORE INSERT ON ledger WHEN new.kind = 'revocation'"
            " BEGIN SELECT RAISE (IGNORE); END"
        ),
    ),
    "a column that computes": ("ALTER TABLE ledger ADD COLUMN more TEXT AS (hex(zeroblob(9)))",),
}


@pytest.mark.timeout(120)
@pytest.mark.parametrize("statements", HOSTILE_TABLES.values(), ids=HOSTILE_TABLES)
def test_a_ledger_that_does_anything_but_hold_lines_is_not_opened(keystore, statements):
    alter(keystore, *statements)
    for work in (keystore.ledger, lambda: audit(keystore)):
        with pytest.raises(KeystoreError, match="not a ledger: another program made"):
            work()


def test_a_name_of_many_megabytes_is_refused_before_it_is_read(keystore):
    """A terminal's escapes are sought in each name: 200 MB took most of a minute."""
    more = "INSERT INTO ledger SELECT 99, at, operator, 'x', hex(zeroblob(9000000)), NULL, NULL,"
    alter(keystore, f"{more} 'y', NULL, '{{}}', 'z' FROM ledger WHERE number = 1")
    for work in (keystore.ledger, lambda: audit(keystore)):
        with pytest.raises(KeystoreError, match="too big"):
            work()


def test_a_ledger_is_for_its_owner_only(keystore):
    assert (keystore.root / "private/ledger.sqlite3").stat().st_mode & 0o777 == 0o600


def test_a_ledger_on_a_disk_that_is_full_says_so(keystore):
    enter(keystore, (entry(number, name="x" * 1000) for number in range(1000)))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(FileError, match="file too large"):
            add(keystore, later="0")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert Keystore.recover(keystore.root)
    assert keystore.names() == ["/later", "/listener", "/talker"]
    audit(keystore)


def test_a_disk_that_refuses_a_folder_by_its_handle_says_so(keystore):
    with (
        (keystore.root / "pqsec.json").open("rb") as file,
        pytest.raises(FileError, match=f"^{keystore.root}: not a directory$"),
        _journal.hold(keystore.root),
    ):
        _ = Folder(file.fileno(), "").names  # an error that has the handle for a name


def as_sqlite_leaves_it(keystore, goal, mode, *, committed):
    """The ledger as another program has it open, that changed a line: its files, copied."""
    with database(keystore) as other:
        other.execute(f"PRAGMA journal_mode = {mode}")
        other.execute("BEGIN")
        other.execute("INSERT INTO ledger SELECT number + 7, at, operator, kind, name, NULL,"
                      " issuer, 'x', not_after, details, 'x' FROM ledger LIMIT 1")  # fmt: skip
        if committed:
            other.execute("COMMIT")
        shutil.copytree(keystore.root, goal, symlinks=True)
    return Keystore.open(goal)


def test_lines_that_sqlite_has_not_written_into_the_ledger_yet_are_read(keystore, tmp_path):
    """As an earlier pqsec leaves them that is killed."""
    copy = as_sqlite_leaves_it(keystore, tmp_path / "copy", "WAL", committed=True)
    ledger = copy.root / "private/ledger.sqlite3"
    assert ledger.with_name("ledger.sqlite3-wal").stat().st_size > 0
    before = {path: path.read_bytes() for path in ledger.parent.iterdir()}
    assert copy.lines()[-1].number == 8
    assert {path: path.read_bytes() for path in ledger.parent.iterdir()} == before
    add(copy, later="0")
    assert [line.number for line in copy.lines()][-3:] == [8, 9, 10]
    assert not list(ledger.parent.glob("ledger.sqlite3-*"))


@pytest.mark.parametrize("work", ["read", "change", "recover"])
def test_a_damaged_ledger_with_a_write_ahead_log_is_no_traceback(keystore, tmp_path, work):
    copy = as_sqlite_leaves_it(keystore, tmp_path / "copy", "WAL", committed=True)
    ledger = copy.root / "private/ledger.sqlite3"
    unfinished(copy)
    ledger.write_bytes(b"damaged " * 1024)
    before = {path: path.read_bytes() for path in ledger.parent.iterdir()}
    works = {
        "read": copy.open_ledger,
        "change": lambda: add(copy, later="0"),
        "recover": lambda: Keystore.recover(copy.root),
    }
    with pytest.raises(KeystoreError, match=f"{ledger}: not a ledger: file is not a database"):
        works[work]()
    assert {path: path.read_bytes() for path in ledger.parent.iterdir()} == before


@pytest.mark.parametrize("left", ["nothing", "an empty file", "the write-ahead log alone"])
def test_a_change_that_is_finished_does_not_begin_a_lost_ledger_anew(keystore, tmp_path, left):
    """A new ledger would lack every revocation."""
    copy = as_sqlite_leaves_it(keystore, tmp_path / "copy", "WAL", committed=True)
    ledger = copy.root / "private/ledger.sqlite3"
    whole = {path: path.read_bytes() for path in ledger.parent.glob("ledger.*")}
    unfinished(copy)
    for path in whole:
        if left != "the write-ahead log alone" or not path.name.endswith("-wal"):
            path.unlink()
    if left == "an empty file":
        ledger.touch()
    there = sorted(ledger.parent.iterdir())
    with pytest.raises(KeystoreError, match="is missing or empty") as refused:
        Keystore.recover(copy.root)
    assert refused.value.hint is not None
    assert "restore it from a backup" in refused.value.hint
    assert sorted(ledger.parent.iterdir()) == there
    for path, data in whole.items():  # from a backup
        path.write_bytes(data)
    assert Keystore.recover(copy.root)
    assert [line.number for line in copy.lines()][-2:] == [8, 9]


def test_what_another_program_was_stopped_at_is_not_read(keystore, tmp_path):
    copy = as_sqlite_leaves_it(keystore, tmp_path / "copy", "DELETE", committed=False)
    with pytest.raises(KeystoreError, match="another program was stopped while changing it"):
        copy.ledger()
    with pytest.raises(KeystoreError, match="another program was stopped while changing it"):
        add(copy, later="0")


@pytest.mark.slow
def test_it_stays_fast_as_it_grows(keystore):
    enter(keystore, (entry(number) for number in range(20_000)))
    standing = status(keystore, now=NOW + timedelta(days=1))
    assert len(standing.participants) == 20_002
