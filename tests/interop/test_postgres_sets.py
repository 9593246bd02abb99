"""Keystores with several sets of credentials, whose ledger several machines share."""

import shutil
from dataclasses import replace

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import (
    CurrentFiles,
    Keystore,
    State,
    audit,
    older_copies,
    signed_governance,
    status,
)
from pqsec_pki.lifecycle import (
    add_set,
    fetch_files,
    issuing,
    move_ledger,
    renew,
    renew_list,
    revoke,
    sign_governance,
)
from tests.interop.shared_ledger import check_whole, copied, issue_to
from tests.unit.killing import NOW, YEAR

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

CLASSICAL, HYBRID, PQ = map(profile_named, ("classical", "hybrid", "pq"))
SETS = {"hybrid": (CLASSICAL, HYBRID), "pq": (CLASSICAL, PQ)}


def create(root, *profiles, ledger=None):
    return Keystore.create(
        root,
        *profiles,
        name="Lab",
        domains=DomainSet.of(0),
        validity=10 * YEAR,
        passphrase=None,
        ledger=ledger,
        now=NOW,
    )


@pytest.fixture
def database(cluster):
    return cluster.database()


@pytest.fixture
def address(cluster, database):
    return cluster.address(database)


@pytest.fixture(params=SETS)
def first(request, address, tmp_path):
    """A keystore with two sets and a participant, and its ledger in a database."""
    create(tmp_path / "first", *SETS[request.param], ledger=address)
    return issue_to(tmp_path / "first", "/alice")


@pytest.fixture
def second(first, tmp_path):
    """The keystore of another machine."""
    return copied(first, tmp_path / "second")


def states(keystore):
    return {each.name: each.state for each in status(keystore, now=NOW).participants}


def new_governance(keystore):
    found = signed_governance(keystore)
    rule = replace(found.domain_rules[0], allow_unauthenticated_participants=True)
    changed = replace(found, domain_rules=(rule,))
    sign_governance(keystore, keystore.unlock(None), changed, now=NOW)


def new_list(keystore):
    revoke(keystore, keystore.unlock(None), ["/alice"], now=NOW)


SHARED = {
    new_governance: ["enclaves/governance.p7s", "enclaves/governance.xml"],
    new_list: ["public/identity_ca.crl.pem"],
}
IN_ENCLAVES = {new_governance: "governance.p7s", new_list: "crl.pem"}


def content(keystore, files):
    """The content of these files in each set, by their place."""
    return [[(each.folder / file).read_bytes() for file in files] for each in keystore.sets]


def test_two_machines_continue_one_chain_in_all_sets(first, second):
    for number, each in enumerate([second, first, second]):
        issue_to(each.root, f"/n{number}")
    check_whole(first, second)
    assert states(second) == {
        "/alice": State.VALID,
        "/n0": State.VALID,
        "/n2": State.VALID,
        "/n1": State.ELSEWHERE,
    }


@pytest.mark.parametrize("change", SHARED)
def test_a_change_begins_with_what_another_machine_made_in_each_set(first, second, change):
    change(first)
    issue_to(second.root, "/bob")
    assert content(second, SHARED[change]) == content(first, SHARED[change])
    for each in second.sets:
        link = each.folder / "enclaves/alice" / IN_ENCLAVES[change]
        assert link.read_bytes() == (each.folder / SHARED[change][0]).read_bytes()
    assert older_copies(second) == []
    check_whole(first, second)


@pytest.mark.parametrize("change", SHARED)
def test_what_leaves_a_machine_is_current_in_each_set(first, second, change):
    change(first)
    for mine, theirs in zip(first.sets, second.sets, strict=True):
        with CurrentFiles.of(theirs) as current:
            newest = (mine.folder / SHARED[change][0]).read_bytes()
            assert current.shared[IN_ENCLAVES[change]] == newest


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("change", SHARED)
def test_what_the_database_lacks_of_one_set_is_fetched_in_none(  # noqa: PLR0913, PLR0917
    first, second, cluster, database, change, number
):
    renew_list(second, second.unlock(None), now=NOW)
    before = content(second, SHARED[change])
    change(first)
    kind = "crl" if change is new_list else "governance"
    lost = [line.sha256 for line in first.ledger() if line.kind == kind][-2:][number]
    cluster.sql(f"DELETE FROM pqsec.files WHERE sha256 = '{lost}'", database)  # noqa: S608 -- a hash
    with pytest.raises(KeystoreError, match="is an older one: line") as told:
        issue_to(second.root, "/bob")
    assert "restore it from a backup, or" in told.value.hint
    assert content(second, SHARED[change]) == before
    assert not any(each.has("/bob") for each in second.sets)


@pytest.mark.parametrize("number", [0, 1])
def test_a_list_that_one_set_lacks_is_missed_with_its_way_out(
    first, second, cluster, database, number
):
    new_list(first)
    lost = [line.sha256 for line in first.ledger() if line.kind == "crl"][number]
    spoil = f"UPDATE pqsec.files SET content = 'nonsense' WHERE sha256 = '{lost}'"  # noqa: S608
    cluster.sql(spoil, database)
    issue_to(second.root, "/bob")
    assert not any(each.has_revocation_list for each in second.sets)
    with CurrentFiles.of(second.sets[number]) as current:
        with pytest.raises(KeystoreError, match="is missing: the ledger has a revocation") as told:
            dict(current.shared)
        assert "`pqsec ca crl`" in told.value.hint
    renew_list(second, second.unlock(None), now=NOW)
    assert [each.revocation_list.number for each in second.sets] == [2, 2]


def test_the_files_of_a_robot_are_fetched_in_all_sets_or_in_none(
    first, second, cluster, database, monkeypatch
):
    certificate = issuing._Maker.certificate
    monkeypatch.setattr(  # until requests are for all sets: a line as they leave it
        issuing._Maker, "certificate", lambda *given: (certificate(*given)[0], "0" * 64)
    )
    places = ["enclaves/robot/cert.pem", "enclaves/robot/permissions.p7s"]
    issue_to(first.root, "/robot")
    fetch_files(second, second.unlock(None), ["/robot"])
    before = content(second, places)
    assert before == content(first, places)
    assert not any(each.has_key("/robot") for each in second.sets)
    assert all(each.verified("/robot", now=NOW) for each in second.sets)
    for number, each in enumerate(first.sets):
        issue_to(first.root, "/robot", force=True)
        lost = each.verified("/robot", now=NOW).certificate.fingerprint
        cluster.sql(
            f"DELETE FROM pqsec.files WHERE sha256 = '{lost}'",  # noqa: S608 -- a hash
            database,
        )
        fetch_files(second, second.unlock(None), ["/robot"])
        assert content(second, places) == before, number
    issue_to(first.root, "/robot", force=True)
    fetch_files(second, second.unlock(None), ["/robot"])
    assert content(second, places) == content(first, places) != before


def test_other_cas_of_a_further_set_are_refused(first, second):
    """As another machine's `ca rotate` leaves them."""
    other = create(first.root.parent / "other", *first.profiles)
    for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
        for where in ("public", "private"):
            key = name.replace("cert", "key") if where == "private" else name
            shutil.copy(other.sets[1].folder / where / key, second.sets[1].folder / where / key)
    (second.root / "public/ledger.checkpoint").unlink()
    folder = second.sets[1].folder
    with pytest.raises(KeystoreError, match=f"{folder}: the CAs are not those of the ledger"):
        issue_to(second.root, "/bob")


# A set that another machine added


@pytest.fixture
def running(address, tmp_path):
    """A keystore with one set on two machines; each has issued a participant."""
    create(tmp_path / "first", CLASSICAL, ledger=address)
    first = issue_to(tmp_path / "first", "/alice")
    second = copied(first, tmp_path / "second")
    return first, issue_to(second.root, "/bob")


def added(keystore, profile=HYBRID):
    return add_set(
        keystore,
        keystore.unlock(None),
        profile,
        validity=10 * YEAR,
        passphrase=None,
        now=NOW,
    )


@pytest.mark.parametrize("profile", [HYBRID, PQ])
def test_a_machine_without_the_set_that_another_added_decides_nothing(running, profile):
    first, second = running
    assert added(first, profile).left == ("/bob",)
    first = Keystore.open(first.root, to_change=True)
    assert first.ledger_address == second.ledger_address
    for work in (
        lambda: issue_to(second.root, "/carol"),
        lambda: renew(second, second.unlock(None), ["/bob"], now=NOW),
        lambda: status(second, now=NOW),
        lambda: Keystore.recover(second.root),
    ):
        with pytest.raises(
            KeystoreError, match=f"lacks the set of credentials {profile.name}"
        ) as told:
            work()
        assert "copy pqsec.json, public/ and sets/ from the one where" in told.value.hint
    assert not second.has("/carol")
    assert not (second.root / "sets").exists()


def test_the_copied_set_is_enough_to_go_on(running):
    first, second = running
    added(first)
    shutil.copy(first.root / "pqsec.json", second.root)
    for folder in ("public", "sets"):
        shutil.copytree(
            first.root / folder, second.root / folder, symlinks=True, dirs_exist_ok=True
        )
    first, second = (Keystore.open(each.root, to_change=True) for each in running)
    issue_to(second.root, "/carol")
    issue_to(second.root, "/bob", force=True)
    assert all(each.has(name) for each in second.sets for name in ("/bob", "/carol"))
    check_whole(first, second)
    assert states(first)["/carol"] is State.ELSEWHERE


def test_a_copy_from_before_a_set_was_added_does_not_join_the_ledger(address, tmp_path):
    create(tmp_path / "first", CLASSICAL)
    first = issue_to(tmp_path / "first", "/alice")
    second = copied(first, tmp_path / "second")
    move_ledger(first, address, now=NOW)
    added(first)
    before = (second.root / "pqsec.json").read_bytes()
    with pytest.raises(KeystoreError, match="lacks the set of credentials hybrid"):
        move_ledger(second, address, now=NOW)
    assert (second.root / "pqsec.json").read_bytes() == before
    assert second.ledger_address is None
    assert audit(second)


@pytest.mark.parametrize("profiles", SETS.values(), ids=SETS)
def test_a_ledger_of_several_sets_is_moved_into_a_database_and_back(tmp_path, address, profiles):
    create(tmp_path / "k", *profiles)
    keystore = issue_to(tmp_path / "k", "/alice")
    second = copied(keystore, tmp_path / "second")
    before = keystore.lines()
    move_ledger(keystore, address, now=NOW)
    assert keystore.lines()[: len(before)] == before
    assert Keystore.open(keystore.root).profiles == profiles
    issue_to(keystore.root, "/bob")
    assert move_ledger(second, address, now=NOW).joined
    issue_to(second.root, "/carol")
    check_whole(keystore, second)
    move_ledger(keystore, None, now=NOW)
    issue_to(keystore.root, "/dora")
    assert all(each.has("/dora") for each in keystore.sets)
    check_whole(keystore)
