"""Plan and apply: whatever is away from the file is seen, made right, and then there is no more."""

import json
import os
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.documents import DomainSet, Governance, Kind, Permissions
from pqsec_pki.domain import Plan, StepAction, apply_plan, create_keystore, plan, read_domain
from pqsec_pki.domain.applying import BATCH
from pqsec_pki.errors import InvalidDocumentError, KeystoreError
from pqsec_pki.keystore import PERMITTED, Keystore, audit
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Rollover,
    Scope,
    issue,
    renew,
    revoke,
    sign_document,
    sign_permissions,
)
from pqsec_pki.smime import document_in
from tests.unit.domains import DAY, FILE, NAMES, NOW, Scene, damage
from tests.unit.keystores import begin_overlap, cancel_overlap
from tests.unit.killing import check_whole
from tests.unit.killing import create as create_transition

# All at once


def test_from_nothing_all_is_made_and_then_nothing_is_left(tmp_path):
    scene = Scene(tmp_path)
    assert scene.steps() == [
        *((StepAction.CREATE_CAS, ""), (StepAction.SIGN_GOVERNANCE, "")),
        *((StepAction.ISSUE, name) for name in ("/r1", "/r2", "/r3", "/monitor")),
    ]
    scene.apply()
    found = scene.plan()
    assert found.in_order
    assert (found.steps, found.blocked, found.unlisted, found.unchanged) == ((), (), (), 4)
    keystore = scene.keystore
    assert keystore.names() == NAMES
    for name in NAMES:
        check_whole(keystore, name)
    assert scene.allowed("/r2") == [["rt/r2/pose"], ["rt/cmd"]]
    assert keystore.participant("/r1").certificate.not_after == NOW + 90 * DAY
    assert "CN=Lab Identity CA" in keystore.identity_ca.subject_name
    audit(keystore)


def test_a_second_apply_touches_no_file(scene):
    def stamps():
        found = [path for path in scene.root.rglob("*") if path.is_file()]
        return {p: os.lstat(p).st_mtime_ns for p in found if "ledger" not in p.name}

    scene.apply()  # has a look at all files, and remembers
    before = stamps()
    scene.apply()
    assert stamps() == before


def test_a_thousand_are_made_in_batches_and_found_in_order(tmp_path):
    scene = Scene(tmp_path)
    scene.change("1..3", "0001..1000")
    scene.change("transition", "classical")
    desired, sizes = read_domain(scene.file), []
    keystore = create_keystore(desired, scene.root, passphrase=None, now=NOW)
    found = scene.plan()
    for batch in apply_plan(desired, keystore, keystore.unlock(None), found, now=NOW):
        sizes.append(len(batch))
        assert len(scene.plan().steps) == len(found.steps) - sum(sizes)
    assert sizes == [BATCH, BATCH, 1]
    assert scene.plan().unchanged == 1001
    serials = [each.serial for each in keystore.ledger() if each.kind == "participant"]
    assert len(set(serials)) == 1001
    audit(keystore)


# What changes in the file


def test_a_new_name_is_issued_and_nobody_else_touched(scene):
    keys = scene.file_of("/r1", "key.pem").read_bytes()
    scene.change("1..3", "1..4")
    assert scene.steps() == [(StepAction.ISSUE, "/r4")]
    scene.apply()
    assert scene.plan().in_order
    assert scene.file_of("/r1", "key.pem").read_bytes() == keys


def test_another_role_needs_new_permissions_and_no_new_certificate(scene):
    before = scene.keystore.participant("/r1")
    scene.change("rt/cmd", "rt/order")
    assert scene.steps() == [(StepAction.SIGN_PERMISSIONS, f"/r{n}") for n in (1, 2, 3)]
    assert set(scene.whys().values()) == {"its role (robot) was changed"}
    scene.apply()
    assert scene.plan().in_order
    assert scene.allowed("/r1") == [["rt/r1/pose"], ["rt/order"]]
    after = scene.keystore.participant("/r1")
    assert after.certificate.fingerprint == before.certificate.fingerprint
    assert check_whole(scene.keystore, "/r1")
    [grant] = Permissions.from_xml(document_in(after.permissions)).grants
    assert (grant.not_before, grant.not_after) == (
        after.certificate.not_before,
        after.certificate.not_after,
    )
    audit(scene.keystore)


def test_groups_are_stored_and_their_changes_are_seen(tmp_path):
    scene = Scene(tmp_path, FILE + "groups: {arms: [/r1, /r2], all: '/*'}\n")
    store = (StepAction.STORE_GROUPS, "")
    assert scene.steps()[2] == store  # after the governance, before participants
    assert scene.plan().steps[2].why == "@all: 4, @arms: 2"
    scene.apply()
    assert scene.steps() == []
    assert scene.keystore.groups == {"all": tuple(NAMES), "arms": ("/r1", "/r2")}
    scene.change("arms: [/r1, /r2]", "arms: /r1")
    assert scene.steps() == [store]
    scene.apply()
    assert scene.keystore.groups["arms"] == ("/r1",)
    scene.write(FILE)
    assert scene.whys() == {"": "the file has none"}
    scene.apply()
    assert scene.keystore.groups == {}
    assert scene.steps() == []


def test_who_leaves_a_group_by_being_revoked_is_no_change(tmp_path):
    scene = Scene(tmp_path, FILE + "groups: {arms: ['/r{1..3}']}\n")
    scene.apply()
    scene.change("/r{1..3}", "/r{1..2}")
    assert scene.steps() == [(StepAction.STORE_GROUPS, "")]  # /r3 may still be revoked with them
    keystore = scene.keystore
    revoke(keystore, keystore.unlock(None), ["/r3"], reason=Reason.UNSPECIFIED, now=NOW)
    assert scene.steps() == []


@pytest.mark.parametrize(
    "content", ["", "[]", "{", '{"format": 2}', '{"format": 1, "groups": {"a": ["../b"]}}']
)
def test_groups_that_cannot_be_read_are_an_error_and_stored_again(scene, content):
    scene.root.joinpath("groups.json").write_text(content)
    with pytest.raises(KeystoreError, match=r"groups\.json: "):
        scene.keystore.named(["@a"])
    assert scene.steps() == [(StepAction.STORE_GROUPS, "")]
    scene.apply()
    assert scene.steps() == []


def test_a_changed_governance_is_signed_anew(scene):
    scene.change("name: Lab", "name: Lab\ngovernance: authenticated\ndomains: 0-3")
    assert scene.steps()[0] == (StepAction.SIGN_GOVERNANCE, "")
    assert scene.whys()[""] == "it was changed"
    scene.apply()
    assert scene.plan().in_order
    signed = Governance.from_xml(document_in(scene.keystore.governance))
    assert signed == read_domain(scene.file).governance
    plain = (scene.root / "enclaves/governance.xml").read_bytes()
    assert Governance.from_xml(plain) == signed


def test_who_is_left_out_stays_unless_it_is_pruned(scene):
    scene.change("1..3", "1..2")
    found = scene.plan()
    assert found.in_order
    assert found.unlisted == ("/r3",)
    assert scene.steps(prune=True) == [(StepAction.REVOKE, "/r3")]
    scene.change("name: Lab", "name: Lab\nprune: true")
    assert scene.steps() == [(StepAction.REVOKE, "/r3")]
    scene.apply()
    found = scene.plan()
    assert found.in_order
    assert found.unlisted == ()
    assert len(scene.keystore.revocation_list.revoked) == 1


def test_nobody_is_pruned_while_two_identity_cas_are_trusted(scene):
    scene.change("1..3", "1..2")
    keystore = scene.keystore
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
    begin_overlap(keystore, terms, kept=keystore.unlock(None), passphrase=None, now=NOW)
    found = scene.plan(prune=True)
    assert ([each.name for each in found.blocked], found.steps) == (["/r3"], ())
    assert "--overlap cancel" in found.blocked[0].way_out
    assert scene.plan().in_order
    cancel_overlap(keystore, now=NOW)
    assert scene.steps(prune=True) == [(StepAction.REVOKE, "/r3")]


def test_who_was_pruned_and_is_wanted_again_is_told_and_not_issued(scene):
    scene.change("1..3", "1..2")
    scene.apply(prune=True)
    scene.change("1..2", "1..3")
    found = scene.plan()
    assert found.steps == ()
    assert [each.name for each in found.ended] == ["/r3"]
    assert "--after-revocation" in found.ended[0].way_back
    assert found.in_order


def test_validity_counts_from_the_next_certificate_on(scene):
    scene.change("validity: 90d", "validity: 200d")
    assert scene.plan().in_order
    scene.apply(NOW + 61 * DAY)
    assert scene.keystore.participant("/r1").certificate.not_after == NOW + 261 * DAY


# Time


@pytest.mark.parametrize(
    ("days", "why"), [(59, None), (60, "ends"), (89, "ends"), (90, "ends"), (91, "expired")]
)
def test_what_is_due_is_renewed(scene, days, why):
    now = NOW + days * DAY
    if why is None:
        assert scene.plan(now).in_order
        return
    assert scene.steps(now) == [(StepAction.RENEW, n) for n in ("/r1", "/r2", "/r3", "/monitor")]
    assert all(each.startswith(why) for each in scene.whys(now).values())
    scene.apply(now)
    assert scene.plan(now).in_order
    assert scene.keystore.participant("/r1").certificate.not_after == now + 90 * DAY
    assert scene.allowed("/r1") == [["rt/r1/pose"], ["rt/cmd"]]


def test_without_renew_before_a_third_of_its_life_is_notice(scene):
    scene.change("renew_before: 30d", "")
    assert scene.plan(NOW + 59 * DAY).in_order
    assert len(scene.steps(NOW + 61 * DAY)) == 4


def test_what_is_due_and_changed_is_signed_and_then_renewed(scene):
    now = NOW + 100 * DAY
    scene.change("rt/cmd", "rt/order")
    actions = [action for action, name in scene.steps(now) if name == "/r1"]
    assert actions == [StepAction.SIGN_PERMISSIONS, StepAction.RENEW]
    scene.apply(now)
    assert scene.plan(now).in_order
    assert scene.allowed("/r1") == [["rt/r1/pose"], ["rt/order"]]


def test_nobody_is_renewed_for_a_ca_that_ends_no_later(tmp_path):
    scene = Scene(tmp_path)
    scene.change("name: Lab", "name: Lab\nca_validity: 10d")
    scene.apply()
    assert scene.keystore.participant("/r1").certificate.not_after == NOW + 10 * DAY
    assert scene.plan(NOW + 9 * DAY).in_order


def test_a_list_that_is_due_is_made_anew(scene):
    scene.change("1..3", "1..2")
    keystore = scene.keystore
    revoke(keystore, keystore.unlock(None), ["/r3"], now=NOW, validity=31 * DAY)
    assert scene.plan().in_order
    now = NOW + 2 * DAY
    assert scene.steps(now) == [(StepAction.RENEW_CRL, "")]
    scene.apply(now)
    assert scene.plan(now).in_order
    assert scene.keystore.revocation_list.number == 2


# What somebody did to the keystore


def drop(path):
    shutil.rmtree(path.parent)


def swap(path):
    shutil.copyfile(str(path).replace("/r1/", "/r2/"), path)


@pytest.mark.parametrize(
    ("file", "what", "step"),
    [
        ("cert.pem", drop, (StepAction.ISSUE, "its certificate is missing")),
        ("cert.pem", os.unlink, (StepAction.REPLACE, "its certificate is missing")),
        ("cert.pem", damage, (StepAction.REPLACE, "its certificate is not the one issued last")),
        ("cert.pem", swap, (StepAction.REPLACE, "its certificate is not the one issued last")),
        (
            "permissions.p7s",
            os.unlink,
            (StepAction.SIGN_PERMISSIONS, "its permissions are not the ones signed"),
        ),
        (
            "permissions.p7s",
            damage,
            (StepAction.SIGN_PERMISSIONS, "its permissions are not the ones signed last"),
        ),
        (
            "permissions.p7s",
            swap,
            (StepAction.SIGN_PERMISSIONS, "its permissions are not the ones signed last"),
        ),
    ],
)
@pytest.mark.parametrize("looked", [False, True])
def test_a_file_that_is_not_as_it_was_made_is_seen_and_made_anew(scene, file, what, step, looked):
    if looked:
        assert scene.plan().in_order  # what was seen then is remembered
    what(scene.file_of("/r1", file))
    [found] = scene.plan().steps
    assert (found.action, found.name) == (step[0], "/r1")
    assert found.why.startswith(step[1])
    scene.apply()
    assert scene.plan().in_order
    for name in NAMES:
        check_whole(scene.keystore, name)


def test_an_old_file_that_is_put_back_is_seen(scene):
    old = scene.file_of("/r1", "permissions.p7s")
    kept = old.with_name("kept")
    shutil.copy2(old, kept)
    scene.change("rt/cmd", "rt/order")
    scene.apply()
    assert scene.plan().in_order
    stat = old.stat()
    kept.replace(old)
    os.utime(old, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert scene.steps() == [(StepAction.SIGN_PERMISSIONS, "/r1")]


def test_permissions_that_were_signed_by_hand_are_replaced_renewed_or_not(scene):
    keystore = scene.keystore
    path = scene.file_of("/r1", "permissions.p7s")
    xml = Permissions.from_xml(document_in(path.read_bytes())).to_xml().replace(b"rt/cmd", b"*")
    scene.file_of("/r1", "permissions.xml").write_bytes(xml)
    sign_document(keystore, Kind.PERMISSIONS, xml, path, keystore.unlock(None), now=NOW, force=True)
    assert scene.steps() == [(StepAction.SIGN_PERMISSIONS, "/r1")]
    renew(keystore, keystore.unlock(None), ["/r1"], now=NOW)
    assert scene.allowed("/r1")[1] == ["*"]
    assert scene.steps() == [(StepAction.SIGN_PERMISSIONS, "/r1")]
    scene.apply()
    assert scene.allowed("/r1")[1] == ["rt/cmd"]


@pytest.mark.parametrize("times", [1, 2])
def test_a_renewal_by_hand_is_no_drift(scene, times):
    scene.change("rt/cmd", "rt/order")
    scene.apply()
    for _ in range(times):
        keystore = scene.keystore
        renew(keystore, keystore.unlock(None), NAMES, now=NOW + DAY)
    assert scene.plan(NOW + DAY).in_order


def test_who_was_revoked_by_hand_is_told(scene):
    keystore = scene.keystore
    revoke(keystore, keystore.unlock(None), ["/r1"], reason=Reason.KEY_COMPROMISE, now=NOW)
    assert [each.name for each in scene.plan().ended] == ["/r1"]
    scene.apply()
    found = scene.plan()
    assert [each.name for each in found.ended] == ["/r1"]
    assert found.in_order


@pytest.mark.parametrize("what", [damage, os.unlink])
def test_a_governance_that_is_not_the_one_signed_is_signed_anew(scene, what):
    what(scene.root / "enclaves/governance.p7s")
    assert scene.steps() == [(StepAction.SIGN_GOVERNANCE, "")]
    assert scene.whys()[""] == "the file is not the one signed last"
    scene.apply()
    assert scene.plan().in_order
    check_whole(scene.keystore, "/r1")


def test_what_another_command_signed_with_the_same_rights_is_not_signed_again(tmp_path):
    scene = Scene(tmp_path)
    scene.apply()
    keystore = scene.keystore
    specs = [member.spec() for member in read_domain(scene.file).members.values()]
    by_hand = [replace(each, config_digest=PERMITTED) for each in specs]
    short = [replace(each, not_after=NOW + 30 * DAY) for each in by_hand[1].grants]
    by_hand[1] = replace(by_hand[1], grants=tuple(short))
    sign_permissions(keystore, keystore.unlock(None), by_hand, now=NOW)
    assert scene.whys() == {"/r2": "its rights were changed by `pqsec permit`"}  # they end early
    sign_permissions(keystore, keystore.unlock(None), specs, now=NOW)
    scene.change("robot: {publish: [rt$name/pose]", "robot: {publish: [rt/$base/pose]")
    assert scene.plan().in_order  # the role says the same in other words
    scene.change("/pose", "/position")
    assert set(scene.whys().values()) == {"its role (robot) was changed"}


def test_a_keystore_made_by_hand_is_taken_over(tmp_path):
    scene = Scene(tmp_path)
    create_transition(scene.root)
    issue_plain(scene.keystore, "/r1", "/stranger")
    scene.change("name: Lab", "name: Lab\ngovernance: migration")
    assert scene.whys()[""] == "its content differs"
    scene.change("governance: migration", "")
    assert scene.steps()[0] == (StepAction.ISSUE, "/r2")  # the governance says the same
    assert scene.whys()["/r1"] == "its permissions were not made from the file"
    scene.apply()
    assert scene.plan().in_order
    assert scene.plan().unlisted == ("/stranger",)


def issue_plain(keystore, *names):
    specs = [
        ParticipantSpec(name=name, domains=DomainSet.of(0), validity=90 * DAY) for name in names
    ]
    issue(keystore, keystore.unlock(None), specs, now=NOW)


# The memory of what was seen


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"{\xff", b'{"/r1": 5, "/r2": "x"}', b"[" * 100_000]
)
def test_a_damaged_memory_only_costs_time(scene, content):
    assert scene.plan().in_order
    memory = scene.root / "private/seen.json"
    memory.write_bytes(content)
    damage(scene.file_of("/r1", "permissions.p7s"))
    assert scene.steps() == [(StepAction.SIGN_PERMISSIONS, "/r1")]
    assert memory.stat().st_mode & 0o777 == 0o600
    assert set(json.loads(memory.read_bytes())) == set(NAMES) - {"/r1"}


def test_a_keystore_that_was_copied_is_looked_at_anew(scene, tmp_path):
    assert scene.plan().in_order
    goal = tmp_path / "copy"
    shutil.copytree(scene.root, goal, symlinks=True)
    damage(goal / "enclaves/r1/permissions.p7s")
    found = plan(read_domain(scene.file), Keystore.open(goal), now=NOW)
    assert [(step.action, step.name) for step in found.steps] == [
        (StepAction.SIGN_PERMISSIONS, "/r1")
    ]


# Refusals


@pytest.mark.parametrize("details", ['{"mark": 5}', '{"mark": ["x"]}', "no JSON", "[1]"])
def test_a_line_with_other_details_is_of_no_use(scene, details):
    alter(scene.root, "UPDATE ledger SET details = ? WHERE name = '/r1'", details)
    assert scene.plan().in_order  # the signed permissions are read
    scene.change("rt/cmd", "rt/order")
    assert {name for _, name in scene.steps()} == {"/r1", "/r2", "/r3"}


@pytest.mark.parametrize("time", ["next year", "2027-01-01", "2027-01-01T00:00:00"])
def test_a_damaged_time_in_the_ledger_is_an_error_of_ours(scene, time):
    alter(scene.root, "UPDATE ledger SET not_after = ? WHERE name = '/r1'", time)
    with pytest.raises(KeystoreError, match="line on participant /r1 is damaged"):
        scene.plan()


def alter(root, statement, value):
    """Change the ledger behind its back."""
    with closing(sqlite3.connect(root / "private/ledger.sqlite3")) as database:
        database.execute("DROP TRIGGER ledger_stays")
        database.execute(statement, [value])
        database.commit()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("profile: transition", "profile: pq", "has profile pq, but .* has profile transition"),
        ("name: Lab", "name: Works", "has the name Works, but the CA of .* is CN=Lab Identity CA"),
        ("name: Lab", "name: La", "has the name La, but"),
    ],
)
def test_another_domains_keystore_is_refused(scene, old, new, told):
    scene.change(old, new)
    with pytest.raises(KeystoreError, match=told) as refusal:
        scene.plan()
    assert refusal.value.hint


def test_without_name_and_profile_any_keystore_will_do(scene):
    scene.change("name: Lab", "")
    scene.change("profile: transition", "")
    assert scene.plan().in_order


# One for all


SLIP = """
roles: {r: {nodes: /$zone}}
participants:
- {name: /a, role: r, values: {zone: hall}}
- {name: /b, role: r, values: {zone: 'no good'}}
- {name: /c, role: r, values: {zone: hall}}
"""


def test_a_slip_in_one_participants_values_leaves_the_others_done(tmp_path):
    scene = Scene(tmp_path, SLIP)
    with pytest.raises(
        InvalidDocumentError, match=r"line 2: .*'/no good' is not a full ROS 2 name"
    ):
        scene.apply()
    assert scene.steps() == [(StepAction.ISSUE, "/b")]
    scene.change("no good", "lab")
    scene.apply()
    assert replace(scene.plan(), unchanged=0) == Plan((), (), (), 0)


def test_who_cannot_be_renewed_keeps_nobody_else_from_it(scene):
    now = NOW + 80 * DAY
    for name in ("/r1", "/monitor"):
        with scene.file_of(name, "permissions.xml").open("ab") as file:
            file.write(b"<!-- somebody is at work here -->")
    with pytest.raises(KeystoreError, match=r"2 participants failed; the first: .*r1"):
        scene.apply(now)
    assert scene.steps(now) == [(StepAction.RENEW, "/r1"), (StepAction.RENEW, "/monitor")]
    audit(scene.keystore)


def test_each_is_renewed_once_for_its_own_validity_whatever_fails(scene):
    scene.change("name: /monitor, role", "name: /monitor, validity: 200d, role")
    with scene.file_of("/monitor", "permissions.xml").open("ab") as file:
        file.write(b"<!-- somebody is at work here -->")
    before = len(scene.keystore.ledger())
    now = NOW + 61 * DAY
    with pytest.raises(KeystoreError, match=r"monitor/permissions\.xml is not what"):
        scene.apply(now)
    assert len(scene.keystore.ledger()) == before + 2 * 3
    scene.file_of("/monitor", "permissions.xml").unlink()
    scene.apply(now)
    ends = [scene.keystore.participant(n).certificate.not_after for n in ("/r1", "/monitor")]
    assert ends == [now + 90 * DAY, now + 200 * DAY]


def test_where_all_fail_it_gives_up(tmp_path):
    scene = Scene(tmp_path, SLIP.replace("name: /b", "name: '/b{1..40}'"))
    with pytest.raises(InvalidDocumentError):
        scene.apply()
    assert len(scene.steps()) >= 40
