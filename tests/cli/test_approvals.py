"""Plans that are proposed, approved and applied, as people type it."""

import json

import pytest

from pqsec_pki.cli import _approver
from tests.cli.conftest import secret
from tests.unit.approving import DOMAIN, GROWS, make_key

PASSPHRASE = b"a passphrase of Bob's own"


@pytest.fixture(scope="module")
def made(run_in, tmp_path_factory):
    """A keystore that demands approvals, and a domain file that gives more rights."""
    folder = tmp_path_factory.mktemp("approvals")
    for name in ("alice", "bob", "carol"):
        make_key(folder, name, passphrase=PASSPHRASE if name == "bob" else None)
    secret(folder / "secret", PASSPHRASE.decode())
    (folder / "domain.yaml").write_text(DOMAIN)
    run_in(folder, "-k k apply --yes --no-passphrase").done()
    (folder / "domain.yaml").write_text(DOMAIN.replace(*GROWS))
    return folder


@pytest.fixture
def run(run_copy, made):
    return run_copy(made)


def propose(run):
    return run("plan -o plan.json --key alice.pem").done()


def approve(run, name="carol", *more):
    return run(f"approve plan.json --key {name}.pem --yes", *more)


def test_a_plan_is_proposed_approved_and_applied(run):
    assert "approvals are needed for rights that grow: 2 of alice, bob, carol" in propose(run).err
    assert approve(run).done().out == "approved by carol: plan.json.carol.approval\n"
    run("apply plan.json --yes").done()
    lines = run("log --json").json["lines"]
    assert [each["name"] for each in lines if each["kind"] == "approval"] == ["alice", "carol"]
    assert "approved by alice, carol" in run("log").out
    run("apply --check").done()
    run("log --verify").done()


def test_approvals_can_be_named_one_by_one(run):
    propose(run)
    approve(run, "carol", "-o", "mail.txt").done()
    run("apply plan.json --yes").refused(1, "1 of 2 approvals: alice", hint="bob, carol")
    run("apply plan.json --yes --approval mail.txt").done()


def test_a_key_with_a_passphrase(run):
    propose(run)
    approve(run, "bob").refused(2, "the key is encrypted", hint="--key-passphrase-file")
    secret(run.folder / "wrong", "another")
    approve(run, "bob", "--key-passphrase-file", "wrong").refused(3, "bob.pem")
    environment = {_approver.VARIABLE: "secret"}
    done = run("approve plan.json --key bob.pem --yes --json", **environment).json
    assert done == {
        "plan": done["plan"],
        "approver": "bob",
        "written": "plan.json.bob.approval",
    }
    assert len(done["plan"]) == 64


def test_the_passphrase_of_the_cas_is_not_taken_for_that_of_an_approver(run):
    propose(run)
    again = run("approve plan.json --key bob.pem --yes", PQSEC_PASSPHRASE_FILE="secret")
    again.refused(2, "the key is encrypted")


def test_without_a_terminal_a_plan_is_shown_and_not_approved(run):
    propose(run)
    shown = run("approve plan.json --key carol.pem")
    shown.refused(2, "no terminal to ask", shows="granted: subscribe 'rt/order' on domain 0")
    assert "domain file: domain.yaml, as it is here" in shown.out
    assert not (run.folder / "plan.json.carol.approval").exists()
    (run.folder / "domain.yaml").write_text(DOMAIN)
    assert "which DIFFERS here" in run("approve plan.json --key carol.pem").out
    (run.folder / "domain.yaml").unlink()
    assert "which is not here" in run("approve plan.json --key carol.pem").out


def test_who_may_not_approve(run):
    propose(run)
    make_key(run.folder, "mallory")
    approve(run, "mallory").refused(1, "this ecdsa-p256 key is of none of the approvers: alice")
    approve(run, "alice").refused(1, "alice proposed this plan, which counts as an approval")
    run("plan -o other.json --key mallory.pem").refused(1, "of none of the approvers")
    assert not [*run.folder.glob("*.approval")]
    assert not (run.folder / "other.json").exists()


def test_a_key_of_another_algorithm_is_nobodys(run):
    propose(run)
    make_key(run.folder, "carol", "ml-dsa-44")
    approve(run).refused(1, "this ml-dsa-44 key is of none of the approvers")


def test_an_approval_is_not_overwritten(run):
    propose(run)
    approve(run).done()
    approve(run).refused(3, "plan.json.carol.approval")
    approve(run, "carol", "--force").done()
    run("plan -o plan.json --key alice.pem").refused(3, "plan.json")


def test_an_expired_plan_is_not_approved(run, monkeypatch):
    from pqsec_pki.cli import _settings  # noqa: PLC0415

    run("plan -o plan.json --key alice.pem --validity 1h").done()
    later = _settings.now() + _settings.Duration().convert("2h", None, None)
    monkeypatch.setattr(_settings, "now", lambda: later)
    approve(run).refused(1, "plan.json: the plan expired on")
    run("apply plan.json --yes").refused(1, "the plan expired on")


def test_an_approval_of_an_older_plan_beside_the_new_one_is_named(run):
    propose(run)
    approve(run).done()
    (run.folder / "plan.json").unlink()
    with (run.folder / "domain.yaml").open("a") as file:
        file.write("# another\n")
    propose(run)
    run("apply plan.json --yes").refused(1, "the approval by carol is of another plan")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("plan -o plan.json", "need each other"),
        ("plan --key alice.pem", "need each other"),
        ("plan --init new.yaml -o plan.json --key alice.pem", "exclude --init"),
        ("plan -o plan.txt --key alice.pem", "must end in .json"),
        ("plan -o plan.json --key ''", "the path of the key is empty"),
        ("plan -o plan.json --key nosuch:key", "packages handle keys"),
        ("apply domain.yaml --approval x", "--approval is for a plan"),
        ("apply plan.json --prune", "are for a domain file"),
        ("apply plan.json --new-keys", "are for a domain file"),
    ],
)
def test_words_that_make_no_sense(run, line, words):
    run(line).refused(2, words)


@pytest.mark.parametrize(
    "line",
    [
        "revoke /r1 --yes",
        "issue /new --publish rt/x",
        "permit /r1 --publish rt/x --yes",
        "ca rotate --apply --yes --no-passphrase",
        "sign-governance k/enclaves/governance.xml --force",
        "sign-permissions k/enclaves/r1/permissions.xml --force",
        "apply --yes",
    ],
)
def test_commands_that_are_covered_are_refused_with_the_way_out(run, line):
    before = run("log --json").out
    run(line).refused(3, "approvals are needed for", hint="plan")
    assert run("log --json").out == before


def test_nothing_is_applied_if_a_part_needs_approvals(run):
    """Rights that shrink come before the revocation, and need none."""
    text = DOMAIN.replace("subscribe: [rt/cmd]", "subscribe: []").replace("1..3", "1..2")
    (run.folder / "domain.yaml").write_text(text)
    before = run("log --json").out
    run("apply --prune --yes").refused(3, "approvals are needed for revocation")
    assert run("log --json").out == before


def test_what_is_not_covered_is_done_as_before(run):
    run("permit /r1 --remove --subscribe rt/cmd --yes").done()
    run("renew /r2").done()
    run("ca crl").done()
    run("ca rotate").done()  # only a plan


def test_nothing_is_proposed_where_nothing_is_demanded(run):
    (run.folder / "free.yaml").write_text("name: Free\nprofile: classical\n")
    run("-k free apply free.yaml --yes --no-passphrase").done()
    with (run.folder / "free.yaml").open("a") as file:
        file.write("domains: 1\ngroups: {}\nparticipants: [{name: /a, rules: [{allow: {}}]}]\n")
    run("-k free plan domain.yaml -o plan.json --key alice.pem")
    assert not (run.folder / "plan.json").exists()
    propose(run)
    run("-k free apply plan.json --yes").refused(3, "free demands no approvals")


@pytest.mark.parametrize("what", ["plan.json", "plan.json.carol.approval"])
def test_a_file_that_is_too_large_is_refused(run, what):
    propose(run)
    approve(run).done()
    path = run.folder / what
    value = json.loads(path.read_bytes())
    with path.open("wb") as file:
        file.write(json.dumps(value).encode())
        file.truncate(80 << 20)
    run("apply plan.json --yes").refused(3, what)


def test_a_plan_that_was_edited_is_refused_by_name(run):
    propose(run)
    path = run.folder / "plan.json"
    path.write_text(path.read_text().replace("rt/order", "rt/oxder"))
    run("approve plan.json --key carol.pem --yes").refused(1, "plan.json: the plan was changed")
    run("apply plan.json --yes").refused(1, "plan.json: the plan was changed after signing")


def test_status_and_report_show_whose_approvals_changes_need(run):
    rule = "2 of alice, bob, carol for grow, revoke, rotate"
    assert f"approvals        {rule}\n" in run("status").done().out
    assert run("status --json").json["approvals"]["required"] == 2
    run("report -o r.html").done()
    assert rule in (run.folder / "r.html").read_text()
    assert run("report --json").json["evidence"]["approvals"] == rule


def test_renew_makes_new_keys_if_people_approved_them(run):
    run("renew /r1 --rekey").refused(3, "approvals are needed for rights that grow")
    run("propose -o plan.json --key alice.pem renew /r1 --rekey").done()
    approve(run)
    before = (run.folder / "k/enclaves/r1/key.pem").read_bytes()
    run("apply plan.json --yes").done()
    assert (run.folder / "k/enclaves/r1/key.pem").read_bytes() != before
