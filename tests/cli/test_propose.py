"""One command that is proposed, approved and run, as people type it."""

import json
from datetime import UTC, datetime

import pytest

from pqsec_pki.access import _witnesses
from pqsec_pki.algorithms import load_private_key
from pqsec_pki.approvals import PlanProposal, proposal_file
from pqsec_pki.approvals import approve as approval_by
from pqsec_pki.cli._proposed import _granted
from pqsec_pki.documents import DomainSet, Grant
from tests.unit.approving import DOMAIN, make_key
from tests.unit.keystores import DAY, NOW

PROPOSE = "propose -o plan.json --key alice.pem"
ROBOT = "request /new --profile classical --dir r"
CSR = "r/requests/new/request.csr"


@pytest.fixture(scope="module")
def made(run_in, tmp_path_factory):
    """A keystore that demands two approvals."""
    folder = tmp_path_factory.mktemp("proposals")
    for name in ("alice", "bob", "carol", "line1"):
        make_key(folder, name)
    (folder / "domain.yaml").write_text(DOMAIN)
    run_in(folder, "-k k apply --yes --no-passphrase").done()
    run_in(folder, ROBOT).done()
    return folder


@pytest.fixture
def run(run_copy, made):
    return run_copy(made)


def approve(run, name="bob"):
    return run(f"approve plan.json --key {name}.pem --yes").done()


def decide(run, command, more=""):
    """Propose, approve and run it."""
    told = run(f"{PROPOSE} {command}").done()
    approve(run)
    return told, run(f"apply plan.json --yes {more}")


def kinds(run):
    return [each["kind"] for each in run("log --json").json["lines"]]


def test_a_revocation_with_its_reason(run):
    run("revoke /r1 --reason keyCompromise --yes").refused(3, hint="pqsec propose -o plan.json")
    told, done = decide(run, "revoke /r1 --reason keyCompromise")
    assert "command: revoke /r1 --reason keyCompromise\n" in told.out
    assert "  revoked: serial number " in told.out
    assert "(keyCompromise)" in done.done().out
    run("apply plan.json --yes").refused(1, "the plan was applied already")
    assert kinds(run)[-5:] == ["plan", "approval", "approval", "revocation", "crl"]
    run("revoke /r2 --yes").refused(3, "approvals are needed")  # it was approved for once


def test_a_set_of_credentials_is_added_when_it_was_approved(run):
    run("ca add-set hybrid").refused(3, "approvals are needed")
    told, done = decide(run, "ca add-set hybrid")
    assert "  new CAs of a set of profile hybrid\n" in told.out
    assert "  a certificate of set hybrid, valid as the first\n" in told.out
    assert "set  k/sets/hybrid" in done.done().out
    run("apply plan.json --yes").refused(1, "the plan was applied already")
    assert kinds(run).count("plan") == 1
    run("log --verify").done()


def test_one_approval_is_not_enough(run):
    run(f"{PROPOSE} revoke /r1").done()
    before = kinds(run)
    run("apply plan.json --yes").refused(1, "1 of 2 approvals: alice")
    run("apply plan.json").refused(2, "a command would be run", shows="revoke /r1")
    assert kinds(run) == before


def test_a_rotation_with_the_same_profile(run):
    told, done = decide(run, "ca rotate --apply --only identity", "--no-passphrase")
    assert "create an identity CA" in told.out
    done.done()
    assert run("ca show").done().out.count("G2") == 1
    run("ca rotate --apply --yes --no-passphrase").refused(3, "approvals are needed")
    assert "approvals      2 of alice, bob, carol for grow, revoke, rotate" in run("ca show").out
    run("log --verify").done()


def test_a_set_of_credentials_is_added_rotated_and_removed(run):
    run("ca add-set hybrid").refused(3, "approvals are needed")
    told, done = decide(run, "ca add-set hybrid")
    assert "new CAs of a set of profile hybrid" in told.out
    done.done()
    for each in run.folder.glob("plan.json*"):
        each.unlink()
    told, done = decide(run, "ca rotate --set hybrid --apply")
    assert "create an identity CA" in told.out
    assert "generation 2" in done.done().out
    for each in run.folder.glob("plan.json*"):
        each.unlink()
    run("ca remove-set hybrid --yes").refused(3, "approvals are needed")
    told, done = decide(run, "ca remove-set hybrid")
    assert "remove the set of credentials of profile hybrid" in told.out
    done.done()
    assert not (run.folder / "k/sets").exists()
    run("log --verify").done()


def test_new_cas_get_the_passphrase_of_apply(run):
    run(f"{PROPOSE} ca rotate --apply").done()
    approve(run)
    run("apply plan.json --yes").refused(2, "need a passphrase")
    run("apply plan.json --yes --no-passphrase").done()  # it goes on with what was begun
    run("apply plan.json --yes --no-passphrase").refused(1, "was applied already")
    assert kinds(run).count("plan") == 1


def test_each_ca_on_a_machine_of_its_own(run):
    (run.folder / "k/private/permissions_ca.key.pem").rename(run.folder / "kept.pem")
    decide(run, "issue /crane --certificate-only")[1].done()
    (run.folder / "kept.pem").rename(run.folder / "k/private/permissions_ca.key.pem")
    (run.folder / "k/private/identity_ca.key.pem").rename(run.folder / "kept.pem")
    (run.folder / "plan.json").unlink()
    (run.folder / "plan.json.bob.approval").unlink()
    decide(run, "permit /crane --publish load")[1].done()


def test_approvers_see_the_key_that_is_certified(run):
    told, done = decide(run, f"issue --csr {CSR} /new --publish x --bundles out")
    assert f"file: {CSR} (SHA-256 " in told.out
    [key] = [line for line in told.out.splitlines() if "certificate for the key" in line]
    done.done()
    [line] = [each for each in run("log --json").json["lines"] if each["name"] == "/new"][:1]
    assert key.split()[-1] == line["details"]["keys"]


def test_approvers_see_the_rights_that_a_sign_request_wishes(run):
    """They saw the key, and the file's name: what it gave was in the file."""
    export = f"sign-request export {CSR} -o fleet.request --domain 3"
    run(f"{export} --publish * --subscribe status --validity 700d").done()
    told, done = decide(run, "sign-request sign fleet.request -o answer")
    for words in (
        "granted: publish every topic on domain 3",
        "granted: subscribe 'status'",
        "valid for 700 days",
    ):
        assert words in told.out
    done.done()
    run(f"{export} --policy policy.xml --force").refused(3)
    (run.folder / "policy.xml").write_text(POLICY)
    (run.folder / "more.xml").write_text(MORE)
    run(f"{export} --policy policy.xml --force").done()
    told = run(f"{PROPOSE} --force sign-request sign fleet.request -o answer").done()
    assert "  granted: publish 'rt/pose'" in told.out


def test_approvers_see_the_rights_of_the_roles_that_an_authority_may_give(run):
    """They saw the names of the roles, and the SHA-256 of a file that they may not have."""
    grant = "ra add line1 --key line1.pub.pem --allow-name /line/* --role robot --max-count 2"
    told = run(f"{PROPOSE} {grant} --validity 9d").done()
    for words in ("role robot:", "granted: publish 'rt/NAME/pose'", "subscribe 'rt/cmd'"):
        assert words in told.out
    text = (run.folder / "domain.yaml").read_text()
    (run.folder / "domain.yaml").write_text(text.replace("rt/cmd", "'*'"))
    told = run(f"{PROPOSE} --force {grant} --validity 9d").done()
    assert "granted: subscribe every topic" in told.out
    run(f"{PROPOSE} --force {grant} --role chief --validity 9d").refused(2, "has no role chief")


def test_approvers_see_what_a_document_changes(run):
    signed = run("permissions read k/enclaves/r1/permissions.p7s").done().out
    (run.folder / "p.yaml").write_text(signed.replace("rt/r1/pose", "rt/stop"))
    told, done = decide(run, "sign-permissions p.yaml")
    assert "  granted: publish 'rt/stop' on domain 0\n" in told.out
    done.done()
    run("governance new --preset migration --domain 0 -o g.yaml").done()
    told = run(f"{PROPOSE} --force sign-governance g.yaml").done()
    assert "weaker: " in told.out


def test_rights_that_cannot_be_compared_wholly_are_approved_by_their_hash(monkeypatch):
    """Two policies with one file included had the same words, if the words were not all."""
    monkeypatch.setattr(_witnesses, "MAX_WORK", 0)
    found = []
    for topic in ("a*", "b*"):
        grant = Grant.least(
            name="/r",
            subject_name="CN=/r",
            not_before=NOW,
            not_after=NOW + DAY,
            domains=DomainSet.of(0),
            publish=(topic,),
        )
        [changed] = _granted([grant])
        assert "not all can be compared: there may be more" in changed.changes
        found.append(changed.changes[-1])
    assert found[0].startswith("rules with SHA-256 ")
    assert found[0] != found[1]


def test_another_file_than_the_approved_one_is_refused(run):
    run(f"{PROPOSE} issue --csr {CSR} /new --publish x --bundles out").done()
    approve(run)
    run(f"{ROBOT} --force").done()
    run("apply plan.json --yes").refused(1, "a file that the command names is another one")
    assert "plan" not in kinds(run)


POLICY = """<policy version="0.2.0" xmlns:xi="http://www.w3.org/2001/XInclude"><enclaves>
<enclave path="/new"><profiles>
<profile ns="/" node="new"><xi:include href="more.xml" xpointer="xpointer(/profile/*)"/></profile>
</profiles></enclave></enclaves></policy>"""
MORE = """<profile ns="/" node="new">
<topics publish="ALLOW"><topic>pose</topic></topics></profile>"""


def approved_with_more(run, command):
    """The command is approved with the file that its policy includes, and run with no other."""
    more = run.folder / "more.xml"
    more.write_text(MORE)
    assert "  granted: publish 'rt/pose'" in run(f"{PROPOSE} {command}").done().out
    approve(run)
    more.write_text(MORE.replace("pose", "stop"))
    run("apply plan.json --yes").refused(1, "what the command changes is not what was approved")
    more.write_text(MORE)
    run("apply plan.json --yes").done()


def test_a_file_that_a_policy_includes_is_approved_too(run):
    (run.folder / "policy.xml").write_text(POLICY)
    approved_with_more(run, "issue --policy policy.xml /new")


def test_what_a_policy_adds_is_approved_with_the_files_that_it_includes(run):
    (run.folder / "policy.xml").write_text(POLICY.replace('"/new"', '"/r1"'))
    approved_with_more(run, "permit --policy policy.xml")
    run("explain /r1 --ros-publish /pose").done()


def test_a_group_that_changes_without_a_line_is_seen(run):
    """The groups are in a file of the keystore, and not in the ledger."""
    with (run.folder / "domain.yaml").open("a") as file:
        file.write("groups: {hall: [/r1]}\n")
    run("apply --yes").done()
    told = run(f"{PROPOSE} permit @hall --publish load").done()
    assert "/r1:\n  members of @hall\n" in told.out
    approve(run)
    groups = run.folder / "k/groups.json"
    groups.write_text(groups.read_text().replace("/r1", "/r2"))
    run("apply plan.json --yes").refused(1, "what the command changes is not what was approved")


def test_another_state_than_the_approved_one_is_refused(run):
    run(f"{PROPOSE} revoke '/r*'").done()
    approve(run)
    run("renew /r2").done()
    run("apply plan.json --yes").refused(1, "the keystore was changed since")


def test_a_change_after_the_plan_began_ends_it(run):
    run(f"{PROPOSE} ca rotate --apply").done()
    approve(run)
    run("apply plan.json --yes").refused(2, "need a passphrase")
    run("renew /r2").done()
    run("apply plan.json --yes --no-passphrase").refused(1, "another change was made")


def edited(run, change):
    path = run.folder / "plan.json"
    value = json.loads(path.read_text())
    change(value["proposal"])
    path.write_text(json.dumps(value))


def test_edited_words_are_refused(run):
    run(f"{PROPOSE} revoke /r1").done()
    approve(run)
    edited(run, lambda plan: plan["steps"][0].update(why="revoke /r2"))
    run("apply plan.json --yes").refused(1, "the plan was changed after signing")


def signed_by_alice(run, change):
    """What an approver can write who does not use `pqsec propose`."""
    path = run.folder / "plan.json"
    value = json.loads(path.read_text())["proposal"]
    change(value)
    made = PlanProposal.from_json(value)

    def approval(name):
        key = load_private_key((run.folder / f"{name}.pem").read_bytes(), None)
        return approval_by(made.digest, name, key, now=datetime.now(UTC))

    path.write_bytes(proposal_file(made, approval("alice")))
    (run.folder / "plan.json.bob.approval").write_bytes(approval("bob").to_file())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda plan: plan.update(needs=[]), "what the command changes is not"),
        (lambda plan: plan.update(rights=[]), "what the command changes is not"),
        (lambda plan: plan["steps"][0].update(why="revoke /r2"), "is another one"),
        (lambda plan: plan.update(expires="2026-01-01T00:00:00+00:00"), "the plan expired"),
        (lambda plan: plan["steps"][0].update(action="revoke"), ""),
        (lambda plan: plan["steps"][0].update(why="demo k2"), "`pqsec demo` cannot be proposed"),
        (lambda plan: plan["steps"][0].update(why="revoke /r1 -k other"), "leave -k out"),
        (lambda plan: plan["steps"][0].update(why="revoke '"), "cannot be read"),
        (lambda plan: plan["steps"].append({**plan["steps"][0]}), "is another one"),
    ],
)
def test_what_the_proposer_misstates_is_refused(run, change, words):
    run(f"{PROPOSE} revoke /r1").done()
    signed_by_alice(run, change)
    refusal = run("apply plan.json --yes")
    assert refusal.code in {1, 2, 3}
    assert words in refusal.err
    assert "plan" not in kinds(run)


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        ("", 2, "COMMAND"),
        ("status", 2, "`pqsec status` cannot be proposed"),
        ("ca", 2, "no command is named"),
        ("ca rotate", 2, "only the plan would be shown"),
        ("-k other revoke /r1", 3, "other does not exist"),
        ("revoke -k other /r1", 2, "leave -k out"),
        ("revoke /r9", 3, "no participant"),
        ("revoke", 2, "nothing to revoke"),
        ("revoke /r1 --passphrase-file bob.pem", 2, "`pqsec apply` takes it"),
        ("revoke /r1 --resaon superseded", 2, "No such option"),
    ],
)
def test_what_cannot_be_proposed(run, command, code, words):
    run(f"{PROPOSE} {command}").refused(code, words)
    assert not (run.folder / "plan.json").exists()


def test_only_approvers_propose(run):
    run("propose -o plan.json --key line1.pem revoke /r1").refused(1, "is of none of the approvers")
    run("propose -o plan --key alice.pem revoke /r1").refused(2, "must end in .json")
    run_without = run("ca init -k free --profile classical --no-passphrase")
    assert run_without.code == 0
    run("propose -k free -o plan.json --key alice.pem ca crl").refused(3, "demands no approvals")


def test_options_of_other_plans_are_refused(run):
    run(f"{PROPOSE} revoke /r1").done()
    for option in ("--check", "--bundles out"):
        run(f"apply plan.json --yes {option}").refused(2, "is not for a plan of one command")


def test_a_registration_authority_by_two_people(run):
    grant = "ra add line1 --key line1.pub.pem --allow-name /line/* --role robot --max-count 2"
    run(f"{grant} --validity 9d").refused(3, "approvals are needed for rights that grow")
    told, done = decide(run, f"{grant} --validity 9d")
    assert "file: domain.yaml" in told.out
    done.done()
    run("request /line/a --profile classical --dir a").done()
    csr = "a/requests/line+a/request.csr"
    run(f"sign-request export {csr} --grant line1.grant --key line1.pem -o order").done()
    told = run(f"{PROPOSE} --force sign-request sign order -o answer").done()
    assert "  the role robot of the grant " in told.out
    run("sign-request sign order -o answer --ra-only").done()
