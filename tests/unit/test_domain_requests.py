"""Participants whose keys are on their robots: what plan and apply do for them, and what not."""

import os
import shutil

import pytest

from pqsec_pki._files import MAX_FILE
from pqsec_pki.algorithms import PROFILES, profile_named
from pqsec_pki.certificates import Certificate, CertificateRequest, Reason, certificate_request
from pqsec_pki.domain import Plan, StepAction, create_keystore, deliver_request, read_domain
from pqsec_pki.enrolment import Bundle, flat_name, refresh, request
from pqsec_pki.errors import (
    ExistsError,
    KeystoreError,
    MalformedError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import audit, status
from pqsec_pki.lifecycle import Rollover, renew, revoke
from pqsec_pki.tokens import reference_to
from tests.unit.domains import DAY, NOW, Scene
from tests.unit.keystores import rotate

FILE = """
name: Lab
profile: classical
validity: 90d
renew_before: 30d
roles:
  robot: {publish: [rt$name/pose]}
participants:
  - {name: "/r{1..2}", role: robot, request: inbox/}
  - {name: /made, role: robot}
"""


class Fleet(Scene):
    """A scene with a folder where requests arrive."""

    def ask(self, name, file=None, profile="classical"):
        """The robot makes (new) keys, and its request arrives."""
        robot = self.file.parent / f"robot{flat_name(name)}"
        made = request(name, profile_named(profile), robot, force=True)
        goal = self.inbox / (file or f"{flat_name(name)}.csr")
        goal.parent.mkdir(exist_ok=True)
        shutil.copyfile(made.path, goal)
        return made.request

    @property
    def inbox(self):
        return self.file.parent / "inbox"

    def certificate(self, name):
        return self.bundle(name).enclaves[name]["cert.pem"]

    def bundle(self, name):
        return Bundle.of(self.keystore, [name], now=NOW)

    def standing(self, now):
        return status(self.keystore, now=now).participants

    def blocked(self, now=NOW):
        return {each.name: each.why for each in self.plan(now).blocked}


@pytest.fixture(scope="module")
def applied_once(tmp_path_factory):
    made = Fleet(tmp_path_factory.mktemp("applied"), FILE)
    made.ask("/r1")
    made.ask("/r2")
    made.apply()
    return made


@pytest.fixture
def fleet(applied_once, tmp_path):
    return Fleet.copy(applied_once, tmp_path)


def keys_in(fleet):
    """Name -> the keys that are certified, as the ledger has them."""
    return {
        each.name: each.details["keys"]
        for each in fleet.keystore.ledger()
        if each.kind == "participant"
    }


# Answering requests


def test_requests_are_answered_and_keys_are_made_only_for_who_has_none(fleet):
    assert fleet.plan().in_order
    assert not fleet.bundle("/r1").has_keys
    assert fleet.bundle("/made").has_keys
    assert fleet.allowed("/r2") == [["rt/r2/pose"], []]
    audit(fleet.keystore)


def test_who_has_not_asked_yet_waits_and_keeps_nobody_else_from_it(tmp_path):
    fleet = Fleet(tmp_path, FILE)
    fleet.ask("/r1")
    assert fleet.blocked() == {"/r2": "has sent no request (new)"}
    fleet.apply()
    assert fleet.keystore.names() == ["/made", "/r1"]
    assert fleet.plan().steps == ()
    assert [each.way_out for each in fleet.plan().blocked] == [
        f"put it at {fleet.inbox / 'r2.csr'}"
    ]
    fleet.ask("/r2")
    assert fleet.steps() == [(StepAction.ISSUE, "/r2")]
    fleet.apply()
    assert fleet.plan().in_order


@pytest.mark.parametrize(
    ("flaw", "words"),
    [
        (
            lambda fleet: fleet.ask("/r1", "r2.csr"),
            "no request in it is for /r2: there is one for /r1",
        ),
        (lambda fleet: fleet.ask("/r2", profile="pq"), "it has ml-dsa-65; profile classical"),
        (lambda fleet: (fleet.inbox / "r2.csr").write_text("nonsense"), "no certificate request"),
        (lambda fleet: (fleet.inbox / "r2.csr").symlink_to("nowhere"), "there is no file"),
        (lambda fleet: (fleet.inbox / "r2.csr").mkdir(), "there is no file"),
        (lambda fleet: os.mkfifo(fleet.inbox / "r2.csr"), "there is no file"),
        (lambda fleet: (fleet.inbox / "r2.csr").symlink_to("/dev/zero"), "there is no file"),
        (lambda fleet: (fleet.inbox / "r2.csr").write_bytes(bytes(MAX_FILE + 1)), "larger than"),
        (
            lambda fleet: tampered(fleet.inbox / "r2.csr"),
            "no proof that the requester has the",
        ),
    ],
    ids=[
        *("another's", "another profile", "no request", "a lost link", "a folder", "a pipe"),
        *("a device", "a large file", "no proof"),
    ],
)
def test_a_request_that_may_not_be_answered_blocks_its_robot_alone(tmp_path, flaw, words):
    fleet = Fleet(tmp_path, FILE)
    fleet.ask("/r1")
    flaw(fleet)
    assert words in fleet.blocked()["/r2"]
    fleet.apply()
    assert fleet.keystore.names() == ["/made", "/r1"]


def tampered(path):
    """A request of /r2 signed by a key that is not the one in it."""
    key, other = (PROFILES[-1].participant_key.generate() for _ in range(2))
    assert PROFILES[-1].name == "classical"
    good, bad = certificate_request("/r2", key, None), certificate_request("/r2", other, None)
    der = bytearray(good.der)
    der[-len(bad.signature) :] = bad.signature
    if len(good.signature) != len(bad.signature):
        der = bytearray(good.der)
        der[-1] ^= 1  # not to 0, which it may be
    path.write_bytes(type(good).from_der(bytes(der)).pem)


def test_a_request_that_is_spoilt_between_plan_and_apply_is_not_answered(tmp_path):
    fleet = Fleet(tmp_path, FILE)
    fleet.ask("/r1")
    fleet.ask("/r2")
    found = fleet.plan()
    fleet.apply()
    fleet.ask("/r1", "r2.csr")
    shutil.rmtree(fleet.root / "enclaves/r2")
    left = tuple(step for step in found.steps if step.name == "/r2")
    with pytest.raises(VerificationError, match=r"r2\.csr: no request in it is for /r2"):
        fleet.take(Plan(left, (), (), 0, fleet.keystore.head))
    assert fleet.keystore.names() == ["/made", "/r1"]


def test_a_request_for_another_key_than_was_planned_is_not_answered(tmp_path):
    fleet = Fleet(tmp_path, FILE)
    fleet.ask("/r1")
    planned = fleet.ask("/r2")
    found = fleet.plan()
    fleet.ask("/r2")  # the folder is open to others, and they were quick
    create_keystore(read_domain(fleet.file), fleet.root, passphrase=None, now=NOW)
    with pytest.raises(VerificationError, match="another key than when the plan was made"):
        fleet.take(found)
    assert fleet.keystore.names() == ["/made", "/r1"]
    (fleet.inbox / "r2.csr").write_bytes(planned.pem)
    fleet.apply()
    assert fleet.plan().in_order


def test_a_request_that_has_gone_since_the_plan_keeps_nobody_else_from_it(tmp_path):
    fleet = Fleet(tmp_path, FILE)
    fleet.ask("/r1")
    fleet.ask("/r2")
    found = fleet.plan()
    (fleet.inbox / "r1.csr").unlink()
    create_keystore(read_domain(fleet.file), fleet.root, passphrase=None, now=NOW)
    with pytest.raises(KeystoreError, match=r"r1\.csr: there is no file"):
        fleet.take(found)
    assert fleet.keystore.names() == ["/made", "/r2"]


def test_requests_that_were_answered_may_go(fleet):
    shutil.rmtree(fleet.inbox)
    assert fleet.plan().in_order
    now = NOW + 70 * DAY
    before = keys_in(fleet)
    fleet.apply(now)
    assert keys_in(fleet)["/r1"] == before["/r1"]
    assert keys_in(fleet)["/made"] != before["/made"]


@pytest.fixture
def one_file(tmp_path):
    """Both robots' requests are in one file, which the domain file names for both."""
    fleet = Fleet(tmp_path, FILE.replace("inbox/", "inbox/all.csr"))
    requests = [fleet.ask(name) for name in ("/r1", "/r2")]
    fleet.all = fleet.inbox / "all.csr"
    fleet.all.write_bytes(b"".join(each.pem for each in requests))
    return fleet


def test_a_file_of_several_requests_answers_each_by_its_name(one_file):
    wanted = {
        each.common_name: each.public_key.spki
        for each in CertificateRequest.all_from_pem(one_file.all.read_bytes())
    }
    one_file.apply()
    made = {name: Certificate.from_pem(one_file.certificate(name)).spki for name in wanted}
    assert made == wanted
    assert one_file.plan().in_order


def test_who_is_not_in_the_file_of_several_is_blocked_alone_until_it_has_a_certificate(one_file):
    of_both = one_file.all.read_bytes()
    shutil.copyfile(one_file.inbox / "r2.csr", one_file.all)
    words = f"its request is refused: {one_file.all}: no request in it is for /r1: there is one for"
    assert one_file.blocked() == {"/r1": f"{words} /r2"}
    one_file.all.write_bytes(of_both)
    one_file.apply()
    shutil.copyfile(one_file.inbox / "r2.csr", one_file.all)  # as if its was answered and removed
    assert one_file.plan().in_order


def test_two_requests_of_one_robot_in_a_file_are_refused(one_file):
    one_file.all.write_bytes(one_file.all.read_bytes() + one_file.ask("/r2").pem)
    assert "2 requests are for /r2" in one_file.blocked()["/r2"]
    assert list(one_file.blocked()) == ["/r2"]
    assert one_file.steps()[-2:] == [(StepAction.ISSUE, "/r1"), (StepAction.ISSUE, "/made")]


def test_another_key_in_a_file_of_several_blocks_its_robot(one_file):
    one_file.apply()
    one_file.all.write_bytes((one_file.inbox / "r1.csr").read_bytes() + one_file.ask("/r2").pem)
    assert one_file.blocked() == {"/r2": "is not changed: its request is for another key"}


def test_a_column_of_a_table_names_requests_too(tmp_path):
    fleet = Fleet(tmp_path, FILE.replace('name: "/r{1..2}"', "csv: r.csv").replace("/}", "}"))
    (tmp_path / "r.csv").write_text("name,request\n/r1,inbox/first.csr\n/r2,\n")
    fleet.ask("/r1", "first.csr")
    members = read_domain(fleet.file).members
    assert members["/r1"].request == fleet.inbox / "first.csr"
    assert members["/r2"].request == fleet.inbox / "r2.csr"


# Renewed, re-keyed, lost


def test_a_renewal_keeps_the_robots_key(fleet):
    now, before = NOW + 70 * DAY, keys_in(fleet)
    assert (StepAction.RENEW, "/r1") in fleet.steps(now)
    fleet.apply(now)
    assert keys_in(fleet)["/r1"] == before["/r1"]
    assert fleet.plan(now).in_order


def test_another_request_is_how_a_robot_gets_another_key(fleet):
    fleet.ask("/r1")
    assert fleet.blocked() == {"/r1": "is not changed: its request is for another key"}
    assert [each.way_out for each in fleet.plan().blocked] == [
        "if the request is really from the robot, use --new-keys"
    ]
    before = keys_in(fleet)
    fleet.apply()
    assert keys_in(fleet) == before
    assert fleet.steps(new_keys=True) == [(StepAction.REPLACE, "/r1")]
    fleet.apply(new_keys=True)
    assert fleet.plan().in_order
    assert keys_in(fleet)["/r1"] != before["/r1"]
    renewed = NOW + DAY
    renew(fleet.keystore, fleet.keystore.unlock(None), ["/r1"], now=renewed)
    assert fleet.plan(renewed).in_order


def test_what_somebody_asks_in_a_robots_name_does_not_keep_it_from_its_renewal(fleet):
    fleet.ask("/r1")
    (fleet.inbox / "r2.csr").write_text("nonsense")
    now, before = NOW + 70 * DAY, keys_in(fleet)
    assert set(fleet.blocked(now)) == {"/r1", "/r2"}
    fleet.apply(now)
    assert keys_in(fleet)["/r1"] == before["/r1"]
    assert fleet.plan(now).steps == ()
    ends = {each.not_after for each in fleet.standing(now) if each.name in {"/r1", "/r2"}}
    assert ends == {now + 90 * DAY}


def test_a_robot_that_asks_takes_over_from_a_key_that_was_made_here(fleet):
    fleet.change("{name: /made, role: robot}", "{name: /made, role: robot, request: inbox/}")
    assert fleet.plan().in_order  # until it asks
    fleet.ask("/made")
    assert "its request is for another key" in fleet.blocked()["/made"]
    assert fleet.file_of("/made", "key.pem").exists()
    fleet.apply(new_keys=True)
    assert fleet.plan().in_order
    assert not fleet.file_of("/made", "key.pem").exists()


@pytest.mark.parametrize("how", ["gone", "other"])
def test_a_lost_certificate_is_issued_anew_from_the_request_alone(fleet, how):
    path = fleet.file_of("/r1", "cert.pem")
    if how == "gone":
        shutil.rmtree(path.parent)
    else:
        shutil.copyfile(fleet.file_of("/r2", "cert.pem"), path)
    before = keys_in(fleet)
    text = fleet.file.read_text()
    fleet.change(", request: inbox/", "")
    [why] = fleet.blocked().values()
    assert why.startswith("has its key elsewhere, and its certificate is")
    fleet.write(text)
    assert [name for _, name in fleet.steps()] == ["/r1"]
    fleet.apply()
    assert fleet.plan().in_order
    assert keys_in(fleet) == before


def test_who_was_given_a_key_here_since_is_issued_anew_like_others(fleet):
    fleet.change(", request: inbox/", "")
    shutil.copyfile(fleet.file_of("/made", "key.pem"), fleet.file_of("/r1", "key.pem"))
    shutil.copyfile(fleet.file_of("/made", "cert.pem"), fleet.file_of("/r1", "cert.pem"))
    assert fleet.steps() == [(StepAction.REPLACE, "/r1")]


# Stranded


def test_a_key_in_a_token_is_not_followed_by_one_in_a_file(fleet):
    fleet.file_of("/made", "key.pem").write_bytes(reference_to("pkcs11:token=lab;object=made"))
    shutil.copyfile(fleet.file_of("/r2", "cert.pem"), fleet.file_of("/made", "cert.pem"))
    assert fleet.blocked()["/made"].startswith("has its key elsewhere, and its certificate is")


def test_who_did_not_come_along_to_the_new_ca_needs_a_new_request(fleet):
    shutil.rmtree(fleet.root / "enclaves/r2")
    backup = fleet.file.parent / "backup"
    shutil.copytree(fleet.root / "enclaves/made", backup, symlinks=True)
    shutil.rmtree(fleet.root / "enclaves/made")
    rotated = rotate(
        fleet.keystore, Rollover(profile=profile_named("pq")), passphrase=None, now=NOW
    )
    assert set(rotated.plan.left_out) == {"/r1"}
    shutil.copytree(backup, fleet.root / "enclaves/made", symlinks=True)
    fleet.change("profile: classical", "profile: pq")
    fleet.change("name: Lab", "")
    assert fleet.whys()["/made"] == "its certificate was issued by a CA that has been replaced"
    assert "it has ecdsa-p256; profile pq here has ml-dsa-65" in fleet.blocked()["/r1"]
    shutil.rmtree(fleet.inbox)
    whys = fleet.blocked()
    assert (
        whys["/r1"]
        == "has sent no request (its certificate was issued by a CA that has been replaced)"
    )
    fleet.change(", request: inbox/", "")
    assert fleet.blocked()["/r1"].startswith(
        "has its key elsewhere, and its certificate was issued by a CA"
    )
    fleet.change(
        "role: robot}\n  - {name: /made", "role: robot, request: inbox/}\n  - {name: /made"
    )
    fleet.ask("/r1", profile="pq")
    fleet.ask("/r2", profile="pq")
    assert set(fleet.blocked()) == {"/r1", "/r2"}
    fleet.apply(new_keys=True)
    assert fleet.plan().in_order


def test_nobody_revokes_who_is_stranded_and_left_out_of_the_file(fleet):
    rotate(fleet.keystore, Rollover(profile=profile_named("pq")), passphrase=None, now=NOW)
    fleet.write(
        FILE.replace('"/r{1..2}"', "/new").replace("classical", "pq").replace("name: Lab", "")
    )
    found = fleet.plan(prune=True)
    assert StepAction.REVOKE not in {step.action for step in found.steps}
    assert found.unlisted == ()


# Compromised


def test_a_key_that_was_revoked_as_compromised_is_seen_in_its_next_certificate(fleet):
    [old] = [each.serial for each in fleet.keystore.ledger() if each.name == "/r1" and each.serial]
    keystore = fleet.keystore
    renew(keystore, keystore.unlock(None), ["/r1"], now=NOW)
    revoke(keystore, keystore.unlock(None), [old], reason=Reason.KEY_COMPROMISE, now=NOW)
    why = "has its key elsewhere, and its key was revoked as compromised"
    assert fleet.blocked() == {"/r1": why}
    fleet.change(", request: inbox/", "")
    assert fleet.blocked() == {"/r1": why}
    fleet.change('"/r{1..2}", role: robot', '"/r{1..2}", role: robot, request: inbox/')
    fleet.ask("/r1")
    assert "its request is for another key, and its key was revoked" in fleet.blocked()["/r1"]
    fleet.apply(new_keys=True)
    assert fleet.plan().in_order


# What the ledger does not know


def test_a_folder_that_the_ledger_does_not_know_keeps_nobody_else_from_it(fleet):
    shutil.copytree(fleet.root / "enclaves/made", fleet.root / "enclaves/copy", symlinks=True)
    fleet.change("name: /made", "name: [/made, /copy, /new]")
    assert fleet.blocked() == {"/copy": "has files that are not in the ledger"}
    fleet.apply()
    assert "/new" in fleet.keystore.names()
    shutil.rmtree(fleet.root / "enclaves/copy")
    fleet.apply()
    assert fleet.plan().in_order


# Bundles


def test_a_folder_of_bundles_follows_the_keystore(fleet, tmp_path):
    folder = tmp_path / "out"

    def refreshed(*names):
        return [path.name for path in refresh(fleet.keystore, names, folder, now=NOW)]

    assert refreshed("/r1", "/r2") == ["r1.bundle", "r2.bundle"]
    assert refreshed("/r1", "/r2") == []
    fleet.ask("/r1")
    fleet.apply(new_keys=True)
    (folder / "r2.bundle").unlink()
    assert refreshed("/r1", "/r2") == ["r1.bundle", "r2.bundle"]
    found = Bundle.from_bytes((folder / "r1.bundle").read_bytes())
    assert found.enclaves["/r1"]["cert.pem"] == fleet.certificate("/r1")


@pytest.mark.parametrize("what", ["another's", "a note", "a lost link"])
def test_what_is_no_bundle_of_that_robots_is_not_replaced(fleet, tmp_path, what):
    goal = tmp_path / "out/r1.bundle"
    assert list(refresh(fleet.keystore, ["/r2"], goal.parent, now=NOW))
    if what == "another's":
        (goal.parent / "r2.bundle").rename(goal)
    elif what == "a note":
        goal.write_text("do not touch")
    else:
        goal.symlink_to("nowhere")
    with pytest.raises(ExistsError, match="is not a bundle for /r1"):
        list(refresh(fleet.keystore, ["/r1"], goal.parent, now=NOW))


def test_a_bundle_of_keys_that_are_here_holds_none(fleet, tmp_path):
    [path] = refresh(fleet.keystore, ["/made"], tmp_path / "out", now=NOW)
    assert not Bundle.from_bytes(path.read_bytes()).has_keys
    with pytest.raises(KeystoreError, match="there is no participant /nobody"):
        list(refresh(fleet.keystore, ["/nobody"], tmp_path / "out", now=NOW))


def test_a_delivered_request_replaces_that_of_its_name_alone(tmp_path):
    fleet = Fleet(tmp_path, FILE.replace("inbox/", "both.csr"))
    first, second, new = (
        request(name, profile_named("classical"), tmp_path / str(number), force=True).request
        for number, name in enumerate(("/r1", "/r2", "/r2"))
    )
    (tmp_path / "both.csr").write_bytes(first.pem + second.pem)
    members = read_domain(fleet.file).members
    deliver_request(members["/r2"], new)
    assert (tmp_path / "both.csr").read_bytes() == first.pem + new.pem
    with pytest.raises(UsageError, match="has no `request` for /made"):
        deliver_request(members["/made"], new)
    (tmp_path / "both.csr").write_bytes(b"damaged")
    with pytest.raises(MalformedError, match=r"both\.csr"):
        deliver_request(members["/r2"], new)
    assert (tmp_path / "both.csr").read_bytes() == b"damaged"
