"""Ledgers in a PostgreSQL server of Debian: two machines, kills, cuts, rights, and moves."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from hashlib import sha256

import psycopg
import pytest
from psycopg import errors

from pqsec_pki.domain import apply, plan, read_domain
from pqsec_pki.enrolment import Bundle
from pqsec_pki.errors import ExistsError, InterruptedChangeError, KeystoreError
from pqsec_pki.keystore import (
    InstallState,
    Keystore,
    Receipt,
    State,
    _postgres,
    _postgres_schema,
    _shared,
    audit,
    change,
    checked_head,
    governance_digest,
    older_copies,
    robot_states,
    schema_sql,
    signed_governance,
    status,
)
from pqsec_pki.lifecycle import (
    Rollover,
    Scope,
    apply_rollover,
    move_ledger,
    plan_rollover,
    renew,
    renew_list,
    revoke,
    sign_governance,
)
from pqsec_pki.vendors import Options, export
from tests.interop.cut import Cutter
from tests.interop.shared_ledger import check_whole, copied, create, issue_to, settled
from tests.postgres import WRITER
from tests.unit.killing import NOW, YEAR, disturbed_calls, survives

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]
_END = (
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
    " WHERE application_name LIKE 'pqsec on %'"
)


@pytest.fixture
def database(cluster) -> str:
    return cluster.database()


@pytest.fixture
def first(cluster, database, tmp_path) -> Keystore:
    """A keystore with a participant, and its ledger in a database."""
    create(tmp_path / "first", cluster.address(database))
    return issue_to(tmp_path / "first", "/alice")


@pytest.fixture
def second(first, tmp_path) -> Keystore:
    """The keystore of another machine."""
    return copied(first, tmp_path / "second")


# One ledger


def test_the_ledger_of_a_keystore_is_in_the_database(first, cluster, database):
    assert not list((first.root / "private").glob("ledger*"))
    found = cluster.sql("SELECT number, kind, written_by FROM pqsec.ledger", database).split()
    assert found[0] == f"1|identity-ca|{WRITER}"
    assert len(found) == len(first.lines()) == 5
    check_whole(first)


def test_who_reads_again_reads_what_is_new(first, second, cluster, database, monkeypatch):
    asked = []
    rows = _postgres.PostgresLedger._rows
    monkeypatch.setattr(
        _postgres.PostgresLedger,
        "_rows",
        lambda self, after=0: asked.append(after) or rows(self, after),
    )
    before = len(first.lines())
    asked.clear()
    assert len(first.lines()) == before
    assert asked == [before]
    issue_to(second.root, "/bob")
    asked.clear()
    assert len(first.lines()) == before + 2
    assert min(asked) >= before
    cluster.sql("DROP SCHEMA pqsec CASCADE", database)
    cluster.sql(schema_sql(writers=[WRITER]), database)
    assert first.as_found.lines() == []  # another ledger at the same address is read from its begin


def test_two_machines_continue_one_chain(first, second):
    for number, each in enumerate([second, first, second, second, first]):
        issue_to(each.root, f"/n{number}")
    check_whole(first, second)
    names = {each.name for each in first.ledger() if each.kind == "participant"}
    assert names == {"/alice", *(f"/n{number}" for number in range(5))}
    assert checked_head(first).head.size == len(second.lines())


def test_a_revocation_of_another_machine_is_in_the_next_list(first, second):
    bob = issue_to(second.root, "/bob")
    revoke(second, second.unlock(None), ["/alice"], now=NOW)
    _, made = revoke(first, first.unlock(None), ["/bob"], now=NOW)
    assert (made.number, len(made.revoked)) == (2, 2)
    assert audit(bob) == audit(first)
    assert older_copies(bob) == [bob.revocation_list_path]
    assert older_copies(first) == []


def new_governance(keystore):
    found = signed_governance(keystore)
    rule = replace(found.domain_rules[0], allow_unauthenticated_participants=True)
    changed = replace(found, domain_rules=(rule,))
    sign_governance(keystore, keystore.unlock(None), changed, now=NOW)


def new_list(keystore):
    revoke(keystore, keystore.unlock(None), ["/alice"], now=NOW)


@pytest.mark.parametrize(
    ("change", "file", "path"),
    [
        (new_list, "crl.pem", "public/identity_ca.crl.pem"),
        (new_governance, "governance.p7s", "enclaves/governance.p7s"),
    ],
)
def test_what_another_machine_made_is_in_what_leaves_this_one(first, second, change, file, path):
    issue_to(second.root, "/bob")
    change(first)
    newest = (first.root / path).read_bytes()
    made = Bundle.of(second, ["/bob"], now=NOW, keys=False)
    assert made.enclaves["/bob"][file] == newest
    assert newest not in [each.read_bytes() for each in second.root.rglob("*") if each.is_file()]
    assert audit(second) == audit(first)
    with pytest.raises(KeystoreError, match="is not the current one: another machine made") as told:
        export("cyclonedds", second, "/bob", Options(), now=NOW)
    assert "`pqsec ca recover`" in told.value.hint
    Keystore.recover(second.root)
    assert (second.root / "enclaves/bob" / file).read_bytes() == newest
    assert older_copies(second) == []
    assert export("cyclonedds", second, "/bob", Options(), now=NOW)


@pytest.mark.parametrize("change", [new_list, new_governance])
def test_a_change_begins_with_what_another_machine_made(first, second, change):
    change(first)
    issue_to(second.root, "/bob")
    assert second.governance == first.governance
    assert second.revocation_list == first.revocation_list
    assert older_copies(second) == []
    xml = [each.root / "enclaves/governance.xml" for each in (first, second)]
    assert xml[0].read_bytes() == xml[1].read_bytes()
    check_whole(first, second)


def test_a_robot_with_a_list_from_before_another_machine_is_outdated(first, second):
    issue_to(second.root, "/bob")
    renew_list(second, second.unlock(None), now=NOW)
    bundle = Bundle.of(second, ["/bob"], now=NOW, keys=False)
    files = {each: sha256(data).hexdigest() for each, data in bundle.enclaves["/bob"].items()}
    receipt = Receipt(
        participant="/bob",
        store="0" * 32,
        number=1,
        bundle=bundle.number,
        files=files,
        installed_at=NOW,
        made_at=NOW,
        pqsec="0",
    )
    with change(second.root) as transaction:
        transaction.record(receipt.entry(second.participant("/bob").certificate, NOW))
    [bob] = status(second, ["/bob"], now=NOW).participants
    assert robot_states(second, [bob])["/bob"].state is InstallState.CURRENT
    revoke(first, first.unlock(None), ["/alice"], now=NOW)
    found = robot_states(second, [bob])["/bob"]
    assert (found.state, found.changed) == (InstallState.OUTDATED, ("crl.pem",))
    assert found.should_run > bundle.number


def test_a_plan_knows_the_governance_of_another_machine(first, second):
    new_governance(first)
    assert signed_governance(second) == signed_governance(first)
    assert governance_digest(second) == governance_digest(first) is not None


def test_what_the_database_does_not_keep_is_not_replaced_by_an_older_file(
    first, second, cluster, database
):
    """As what an older pqsec wrote."""
    new_list(second)
    renew_list(first, first.unlock(None), now=NOW)
    cluster.sql("DELETE FROM pqsec.files", database)
    issue_to(first.root, "/carol")
    with pytest.raises(KeystoreError, match="is an older one: line"):
        issue_to(second.root, "/bob")
    renew_list(second, second.unlock(None), now=NOW)
    issue_to(second.root, "/bob")
    assert Bundle.of(second, ["/bob"], now=NOW)
    cluster.sql("DELETE FROM pqsec.files", database)
    with pytest.raises(KeystoreError, match="not the newest revocation list") as told:
        Bundle.of(first, ["/carol"], now=NOW)
    assert "docs/how-to/postgresql.md" in told.value.hint


def test_a_list_of_another_ca_is_not_taken_from_the_database(first, second, cluster, database):
    new_list(first)
    cluster.sql("UPDATE pqsec.files SET content = 'nonsense'", database)
    with pytest.raises(KeystoreError, match="revocation list"):
        Bundle.of(second, ["/alice"], now=NOW, keys=False)


def test_a_database_from_before_a_line_that_the_cas_signed_decides_nothing(
    first, second, cluster, database
):
    new_list(second)
    before = len(first.lines())
    issue_to(first.root, "/bob")
    cut = f"DELETE FROM pqsec.ledger WHERE number > {before};"  # noqa: S608 -- a number
    switched = [f"ALTER TABLE pqsec.ledger {each} TRIGGER USER;" for each in ("DISABLE", "ENABLE")]
    cluster.sql(cut.join(switched), database)
    for work in (
        lambda: issue_to(first.root, "/carol"),
        lambda: Bundle.of(first, ["/bob"], now=NOW),
        lambda: first.approvals,
        lambda: status(first, now=NOW),
    ):
        with pytest.raises(KeystoreError, match="the ledger lacks lines"):
            work()
    assert status(second, now=NOW)  # it has seen no head with these lines


def test_another_keystore_does_not_begin_in_a_database_with_lines(first, tmp_path):
    with pytest.raises(ExistsError, match="has the ledger of a keystore already"):
        create(tmp_path / "other", first.ledger_address)
    assert not (tmp_path / "other/pqsec.json").exists()
    assert len(first.lines()) == 5


def test_an_older_pqsec_refuses_the_keystore(first):
    assert '"format": 4' in (first.root / "pqsec.json").read_text()


def test_without_the_tables_it_is_said_how_they_are_made(cluster, tmp_path):
    with pytest.raises(KeystoreError, match="has no ledger") as refusal:
        create(tmp_path / "k", cluster.address(cluster.database(tables=False)))
    assert "pqsec ledger schema" in refusal.value.hint
    assert not (tmp_path / "k/pqsec.json").exists()


def test_tables_are_made_once_and_brought_up_to_date(first, cluster, database, monkeypatch):
    cluster.sql(schema_sql([WRITER]), database)
    newer = "ALTER TABLE pqsec.ledger ADD COLUMN remark text;\n"
    monkeypatch.setattr(_postgres_schema, "_FORMATS", (*_postgres_schema._FORMATS, newer))
    monkeypatch.setattr(_postgres_schema, "FORMAT", 5)
    with pytest.raises(KeystoreError, match="made by an older pqsec"):
        first.lines()
    cluster.sql(schema_sql([WRITER]), database)
    assert len(first.lines()) == 5
    monkeypatch.setattr(_postgres_schema, "FORMAT", 4)
    with pytest.raises(KeystoreError, match="made by another version of pqsec"):
        first.lines()


def test_a_command_waits_for_the_lock_and_then_says_who_has_it(first, second, monkeypatch):
    shorter = _postgres._SESSION_SQL.replace("'30s'", "'100ms'")
    monkeypatch.setattr(_postgres, "_SESSION_SQL", shorter)
    words = f"another pqsec command is using this ledger: pqsec on .* by role {WRITER}$"
    with first.hold(), pytest.raises(KeystoreError, match=words):
        issue_to(second.root, "/bob")
    issue_to(second.root, "/bob")
    with first.hold():
        issue_to(first.root, "/carol")
    check_whole(first, second)


def spare(keystore):
    """The connection that is kept for the next hold."""
    return _shared._connections.spare.get((os.getpid(), keystore.root))


def test_a_connection_stays_open_between_two_holds_and_the_lock_does_not(first, second):
    with first.hold(keep_connection=True):
        issue_to(first.root, "/bob")
    kept = spare(first)
    issue_to(second.root, "/carol")
    with first.hold(keep_connection=True):
        assert len(first.lines()) == len(second.lines())
        issue_to(first.root, "/dave")
    assert spare(first) is kept
    check_whole(first, second)


@pytest.mark.parametrize("lost", [True, False], ids=["ended", "too old"])
def test_a_connection_is_made_anew(first, cluster, database, monkeypatch, lost):
    with first.hold(keep_connection=True):
        kept = issue_to(first.root, "/bob") and spare(first)
    if lost:
        cluster.sql(_END, database)
    else:
        monkeypatch.setattr(_postgres, "_LONGEST", -1.0)
    with first.hold(keep_connection=True):
        issue_to(first.root, "/carol")
    assert spare(first) is not kept
    check_whole(first)


def test_a_kept_connection_does_not_serve_a_ledger_of_another_version(first, cluster, database):
    with first.hold(keep_connection=True):
        issue_to(first.root, "/bob")
    cluster.sql("INSERT INTO pqsec.format VALUES (99)", database)
    with pytest.raises(KeystoreError, match="version"), first.hold(keep_connection=True):
        issue_to(first.root, "/carol")
    assert not first.has("/carol")


def test_after_an_error_no_lock_and_no_connection_is_kept(first, second):
    with pytest.raises(ZeroDivisionError), first.hold(keep_connection=True):
        1 / 0  # noqa: B018
    assert spare(first) is None
    issue_to(second.root, "/bob")


def test_the_address_in_a_keystore_that_others_write_is_not_followed(first):
    (first.root).chmod(0o777)
    with pytest.raises(KeystoreError, match="anybody may write there"):
        first.lines()


def states(keystore: Keystore, *, compare: bool = False) -> dict[str, State]:
    found = status(keystore, now=NOW, compare_files=compare)
    return {each.name: each.state for each in found.participants}


def test_the_files_of_another_machine_are_said_to_be_there(first, second):
    issue_to(second.root, "/bob")
    assert states(first) == {"/alice": State.VALID, "/bob": State.ELSEWHERE}
    assert states(second) == {"/alice": State.VALID, "/bob": State.VALID}
    with pytest.raises(ExistsError, match="already issued on another machine"):
        issue_to(first.root, "/bob")
    with pytest.raises(KeystoreError, match="files of /bob are on another machine"):
        renew(first, first.unlock(None), ["/bob"], now=NOW)
    issue_to(first.root, "/bob", force=True)
    assert states(first, compare=True)["/bob"] is State.VALID
    assert states(second, compare=True)["/bob"] is State.ELSEWHERE
    with pytest.raises(KeystoreError, match="another machine has it"):
        renew(second, second.unlock(None), ["/bob"], now=NOW)


def test_a_plan_leaves_what_is_on_another_machine_there(first, second, tmp_path):
    path = tmp_path / "domain.yaml"
    path.write_text(
        "name: Lab\nprofile: classical\nparticipants:\n  - {name: /bob, publish: [rt/a]}\n"
    )
    desired = read_domain(path)
    apply(desired, second.root, passphrase=None, now=NOW)
    assert [each.action for each in plan(desired, first, now=NOW).steps] == []
    path.write_text(path.read_text().replace("rt/a", "rt/b"))
    [blocked] = plan(read_domain(path), first, now=NOW).blocked
    assert "on another machine" in blocked.why


def test_new_cas_of_one_machine_are_needed_on_the_other(first, second):
    terms = Rollover(profile=first.profile, scope=Scope.IDENTITY, validity=10 * YEAR)
    apply_rollover(first, plan_rollover(first, terms, now=NOW), kept=first.unlock(None), now=NOW)
    with pytest.raises(KeystoreError, match="not those of the ledger") as refusal:
        issue_to(second.root, "/bob")
    assert "copy public/ and private/" in refusal.value.hint
    for name in ("public", "private"):
        shutil.rmtree(second.root / name)
        shutil.copytree(first.root / name, second.root / name)
    issue_to(second.root, "/bob")
    issue_to(first.root, "/carol")


# Rights

INSERT = "INSERT INTO pqsec.ledger (number, at, kind, name, sha256, details, chain"


@pytest.mark.parametrize("user", [WRITER, "owner"])
@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE pqsec.ledger SET name = 'x'",
        "DELETE FROM pqsec.ledger WHERE number = 5",
        "TRUNCATE pqsec.ledger",
        f"{INSERT}) VALUES (99, '', '', '', '', '', '')",
    ],
)
def test_the_database_itself_lets_nobody_change_lines(first, cluster, database, statement, user):
    with pytest.raises(subprocess.CalledProcessError) as refusal:
        cluster.sql(statement, database, user)
    why = "permission denied" if user == WRITER else "lines are only added"
    assert ("does not follow" if statement.startswith("INSERT") else why) in refusal.value.stderr
    check_whole(first)


def test_a_writer_cannot_say_that_another_role_wrote(first, cluster, database):
    with pytest.raises(subprocess.CalledProcessError) as refusal:
        cluster.sql(
            f"{INSERT}, written_by) VALUES (6, '', '', '', '', '', '', 'owner')",
            database,
            WRITER,
        )
    assert "permission denied" in refusal.value.stderr


OLD_LOCK = int.from_bytes(sha256(b"pqsec ledger").digest()[:8], "big", signed=True)


def test_a_reader_cannot_keep_writers_from_adding_lines(first, cluster, database, monkeypatch):
    """An advisory lock, as it was, can be taken by every role; so can the locks of a reader."""
    shorter = _postgres._SESSION_SQL.replace("'30s'", "'500ms'")
    monkeypatch.setattr(_postgres, "_SESSION_SQL", shorter)
    cluster.sql("CREATE ROLE watcher LOGIN", database)
    cluster.sql(schema_sql(readers=["watcher"]), database)
    url = cluster.address(database, "watcher").url
    with psycopg.connect(url) as reader:  # in one transaction, until its end
        reader.execute("SELECT pg_advisory_lock(%s), pg_advisory_xact_lock(%s)", [OLD_LOCK] * 2)
        for table in ("ledger", "format", "files"):
            reader.execute(f"SELECT count(*) FROM pqsec.{table}")  # noqa: S608 -- names of above
            reader.execute(f"LOCK TABLE pqsec.{table} IN ACCESS SHARE MODE")
        issue_to(first.root, "/bob")
        with first.hold():
            issue_to(first.root, "/carol")
    for statement in (
        "SELECT FROM pqsec.writing FOR UPDATE",
        "SELECT FROM pqsec.writing FOR KEY SHARE",
        "LOCK TABLE pqsec.writing IN ROW SHARE MODE",
        *(f"LOCK TABLE pqsec.{each} IN SHARE MODE" for each in ("ledger", "format", "files")),
        "SELECT FROM pqsec.ledger FOR KEY SHARE",
    ):
        with psycopg.connect(url) as reader, pytest.raises(errors.InsufficientPrivilege):
            reader.execute(statement)
    check_whole(first)


def test_the_role_that_has_the_lock_is_named_also_to_another_role(
    first, second, cluster, database, monkeypatch
):
    shorter = _postgres._SESSION_SQL.replace("'30s'", "'100ms'")
    monkeypatch.setattr(_postgres, "_SESSION_SQL", shorter)
    cluster.sql("CREATE ROLE night LOGIN", database)
    cluster.sql(schema_sql(writers=["night"]), database)
    settings = second.root / "pqsec.json"
    settings.write_text(settings.read_text().replace(f"{WRITER}@", "night@"))
    with first.hold(), pytest.raises(KeystoreError, match=f"pqsec on .* by role {WRITER}$"):
        issue_to(second.root, "/bob")
    with second.hold(), pytest.raises(KeystoreError, match=r"pqsec on .* by role night$"):
        issue_to(first.root, "/bob")
    issue_to(second.root, "/bob")
    check_whole(first, second)


def test_who_lost_the_lock_in_a_hold_adds_no_line(first, second, cluster, database):
    before = first.head
    holder = "mode = 'RowShareLock' AND relation = 'pqsec.writing'::regclass"
    end = f"SELECT pg_terminate_backend(pid) FROM pg_locks WHERE {holder}"  # noqa: S608 -- as above
    with pytest.raises(KeystoreError, match="terminat"), first.hold():  # noqa: PT012 -- in a hold
        assert cluster.sql(end, database).split() == ["t"]
        issue_to(first.root, "/bob")
    assert second.head == before
    issue_to(second.root, "/bob")
    check_whole(first, second)


def test_a_reader_reads_and_adds_nothing(first, cluster, database):
    cluster.sql("CREATE ROLE auditor LOGIN", database)
    cluster.sql(schema_sql(readers=["auditor"]), database)
    settings = first.root / "pqsec.json"
    settings.write_text(settings.read_text().replace(f"{WRITER}@", "auditor@"))
    check_whole(first)
    with pytest.raises(KeystoreError, match="permission denied") as refusal:
        issue_to(first.root, "/bob")
    assert "rights" in refusal.value.hint
    assert not (first.root / "enclaves/bob").exists()


# Kills and cuts


WRITER_PROCESS = """
import sys
from pathlib import Path
from tests.interop.shared_ledger import issue_to
root, name = sys.argv[1:]
for number in range(2):
    issue_to(Path(root), f"/{name}/n{number}")
"""


@pytest.mark.slow
def test_eight_writers_on_two_machines_make_one_chain(first, second):
    roots = [each.root for _ in range(4) for each in (first, second)]
    commands = [
        subprocess.Popen([sys.executable, "-c", WRITER_PROCESS, root, f"w{number}"])
        for number, root in enumerate(roots)
    ]
    assert [each.wait(240) for each in commands] == [0] * 8
    check_whole(first, second)
    assert len([each for each in first.ledger() if each.kind == "participant"]) == 1 + 8 * 2


def test_a_writer_that_is_killed_at_any_call_leaves_all_or_nothing(first):
    issued = []
    for calls in disturbed_calls(9):
        name = f"/n{calls}"
        ended = survives(calls, lambda name=name: issue_to(first.root, name))
        issued.append(settled(first, name))
        if ended:
            break
    assert issued == sorted(issued)
    assert set(issued) == {False, True}


@pytest.mark.parametrize("committed", [False, True])
def test_a_commit_whose_answer_is_lost_is_found_out_at_once(first, cluster, committed):
    with Cutter(cluster, first) as cutter:
        cutter.cut_at(b"COMMIT", deliver=committed)
        if committed:
            issue_to(first.root, "/bob")
        else:
            with pytest.raises(KeystoreError, match="connection") as refusal:
                issue_to(first.root, "/bob")
            assert "nothing was changed" in refusal.value.hint
    assert settled(first, "/bob") is committed


@pytest.mark.parametrize("committed", [False, True])
def test_a_commit_is_found_out_when_the_network_is_back(first, cluster, committed):
    with Cutter(cluster, first) as cutter:
        cutter.cut_at(b"COMMIT", deliver=committed, stay=True)
        with pytest.raises(InterruptedChangeError, match="only the database knows"):
            issue_to(first.root, "/bob")
        with pytest.raises(InterruptedChangeError, match="interrupted"):
            Keystore.open(first.root)
        with pytest.raises(InterruptedChangeError, match="only the database knows"):
            Keystore.open(first.root, to_change=True)
        assert not first.has("/bob")
    assert settled(first, "/bob") is committed
    assert settled(issue_to(first.root, "/carol"), "/carol")


def test_a_network_that_is_cut_before_changes_nothing(first, cluster):
    with Cutter(cluster, first) as cutter:
        cutter.cut_at(b"COPY")
        with pytest.raises(KeystoreError) as refusal:
            issue_to(first.root, "/bob")
        assert "nothing was changed" in refusal.value.hint
    assert not settled(first, "/bob")
    assert settled(issue_to(first.root, "/bob"), "/bob")


# Another place


def test_a_ledger_is_moved_into_a_database_and_back(tmp_path, cluster, database):
    create(tmp_path / "k")
    keystore = issue_to(tmp_path / "k", "/alice")
    before = keystore.lines()
    moved = move_ledger(keystore, cluster.address(database), now=NOW)
    assert (moved.lines, moved.joined) == (len(before) + 1, False)
    assert keystore.lines()[: len(before)] == before
    assert not list((keystore.root / "private").glob("ledger*"))
    issue_to(keystore.root, "/bob")
    check_whole(keystore)
    other = copied(keystore, tmp_path / "other")
    lines = keystore.lines()
    move_ledger(keystore, None, now=NOW)
    assert keystore.lines()[: len(lines)] == lines
    issue_to(keystore.root, "/carol")
    check_whole(keystore)
    with pytest.raises(KeystoreError, match="was moved to a file"):
        issue_to(other.root, "/dora")
    move_ledger(keystore, cluster.address(database), now=NOW)
    issue_to(other.root, "/dora")
    check_whole(keystore, other)


@pytest.mark.slow
def test_a_move_that_is_killed_at_any_call_is_made_or_not(tmp_path, cluster):
    original, moved = tmp_path / "original", []
    create(original)
    before = issue_to(original, "/alice").lines()
    for calls in disturbed_calls(9):
        keystore = copied(Keystore.open(original), tmp_path / f"{calls}")
        address = cluster.address(cluster.database())
        ended = survives(calls, lambda k=keystore, a=address: move_ledger(k, a, now=NOW))
        Keystore.recover(keystore.root)
        check_whole(keystore)
        moved.append(keystore.ledger_address == address)
        assert keystore.lines()[: len(before)] == before
        has_file = (keystore.root / "private/ledger.sqlite3").exists()
        assert has_file is not moved[-1]
        if ended:
            break
        if not moved[-1]:
            move_ledger(keystore, address, now=NOW)
            check_whole(keystore)
    assert moved == sorted(moved)
    assert set(moved) == {False, True}


def test_a_copy_on_another_machine_joins_its_ledger(tmp_path, cluster, database):
    create(tmp_path / "first")
    first = issue_to(tmp_path / "first", "/alice")
    second = copied(first, tmp_path / "second")
    move_ledger(first, cluster.address(database), now=NOW)
    assert move_ledger(second, cluster.address(database), now=NOW).joined
    issue_to(second.root, "/bob")
    check_whole(first, second)


def test_a_database_with_another_ledger_is_refused(first, tmp_path):
    create(tmp_path / "other")
    other = issue_to(tmp_path / "other", "/alice")
    before = other.lines()
    with pytest.raises(KeystoreError, match="the ledger of another keystore: line 1 differs"):
        move_ledger(other, first.ledger_address, now=NOW)
    assert other.lines() == before
    check_whole(first)
