"""renew, needs-renewal, revoke, ca crl, status and log, as their users run them."""

import json
import re
import shutil
import sqlite3
from contextlib import closing

import pytest

from tests.cli.conftest import snapshot


@pytest.fixture
def k(keystore):
    return keystore("classical")


def serial(pqsec, name):
    found = pqsec("-k k status --json").json["participants"]
    return next(each["serial"] for each in found if each["name"] == name)


# revoke


def test_revoke_tells_what_it_did(pqsec, k):
    number = serial(pqsec, "/talker")
    done = pqsec("-k k revoke /talker --reason keyCompromise").done()
    first, second = done.out.splitlines()
    assert re.fullmatch(rf"/talker  {number}  revoked \d{{4}}-\d\d-\d\d \(keyCompromise\)", first)
    assert re.fullmatch(
        r"list 1: 1 certificate, next due by \S+  k/public/identity_ca.crl.pem", second
    )
    assert "OpenDDS does not read it" in done.err
    done = pqsec(f"-k k revoke {number} /listener --json").done()
    assert done.err == ""
    assert [each["before"] for each in done.json["revoked"]] == [True, False]
    assert [each["listed"] for each in done.json["revoked"]] == [True, True]
    assert done.json["number"] == done.json["certificates"] == 2
    assert (k / "enclaves/talker/crl.pem").read_bytes() == (k / done.json["list"][2:]).read_bytes()


def test_to_revoke_what_an_earlier_ca_issued_says_that_no_list_has_it(pqsec, k):
    number = serial(pqsec, "/talker")
    pqsec("-k k ca rotate --apply --no-passphrase").done()
    done = pqsec(f"-k k --json revoke {number}").done()
    assert [each["listed"] for each in done.json["revoked"]] == [False]
    assert done.json["certificates"] == 0
    assert "certificates of an earlier CA are not in a list" in done.err
    assert (k / "public/identity_ca.crl.pem").exists()


def test_revoke_refuses_who_is_not_known(pqsec, k):
    before = snapshot(k)
    pqsec("-k k revoke /nobody").refused(3, "/nobody", hint="pqsec status")
    pqsec("-k k revoke /talker --reason hold").refused(
        2, "'hold' is not one of 'unspecified', 'keyCompromise'"
    )
    pqsec("-k k revoke").refused(2, "NAME|SERIAL")
    pqsec("-k k revoke /talker --validity 999999y").refused(2, "beyond 2261")
    assert snapshot(k) == before


def test_verify_handshake_refuses_a_revoked_participant(pqsec, k):
    pqsec("-k k verify-handshake /talker /listener").done()
    pqsec("-k k revoke /talker")
    answer = pqsec("-k k verify-handshake /talker /listener")
    assert answer.code == 1
    assert "the certificate of CN=/talker was revoked on" in answer.out
    assert (
        "hint: to issue /talker again, use `pqsec issue` with --force --after-revocation"
        in answer.out
    )


def test_issue_refuses_a_revoked_name_unless_told(pqsec, k):
    pqsec("-k k revoke /talker")
    line = "-k k issue /talker --publish x --subscribe x --force"
    pqsec(line).refused(3, "revoked: /talker", hint="--after-revocation")
    pqsec(f"{line} --after-revocation").done()
    assert pqsec("-k k verify-handshake /talker /listener").code == 0


# ca crl


def test_ca_crl_shows_makes_and_writes_the_list(pqsec, k, tmp_path):
    pqsec("-k k ca crl --show").refused(3, "no revocation list", hint="pqsec revoke")
    pqsec("-k k ca crl").done()
    made = pqsec("-k k ca crl -o out.crl --validity 30d --json").done().json
    assert (made["number"], made["certificates"]) == (2, 0)
    assert (tmp_path / "out.crl").read_bytes() == (k / "public/identity_ca.crl.pem").read_bytes()
    pqsec("-k k ca crl -o out.crl").refused(3, "out.crl exists", hint="--force")
    shown = pqsec("-k k ca crl --show -o out.crl --force --json").done().json
    assert shown == made


def test_a_list_needs_the_passphrase(pqsec, locked):
    pqsec("-k k ca crl --passphrase-file wrong").refused(3, "passphrase")
    pqsec("-k k ca crl --passphrase-file right").done()
    pqsec("-k k ca crl --show").done()
    assert (locked / "public/identity_ca.crl.pem").exists()


# renew


def test_renew_takes_names_or_due_or_all(pqsec, k):
    before = serial(pqsec, "/talker")
    done = pqsec("-k k renew talker").done()
    assert re.fullmatch(r"/talker  until \d{4}-\d\d-\d\d  k/enclaves/talker\n", done.out)
    assert serial(pqsec, "/talker") != before
    assert pqsec("-k k renew --due").done().out == "nothing to renew\n"
    assert pqsec("-k k renew --due 30d --json").done().json["issued"] == []
    both = pqsec("-k k renew --due 2y --json").done().json["issued"]
    assert {each["name"] for each in both} == {"/talker", "/listener"}
    assert len(pqsec("-k k renew --all").done().out.splitlines()) == 2
    assert pqsec("-k k verify-handshake /talker /listener").code == 0


@pytest.mark.parametrize("words", ["", "--all /talker", "--all --due 3d", "--due 3d /talker"])
def test_renew_wants_one_of_them(pqsec, k, words):
    said = "names, --due and --all exclude each other" if words else "no participant named"
    pqsec(f"-k k renew {words}").refused(2, said)


def test_renew_all_leaves_out_who_is_revoked_or_gone(pqsec, k):
    pqsec("-k k issue /third --publish x")
    pqsec("-k k revoke /talker")
    shutil.rmtree(k / "enclaves/third")
    done = pqsec("-k k renew --all --json").done().json
    assert [each["name"] for each in done["issued"]] == ["/listener"]
    pqsec("-k k renew /talker").refused(3, "revoked: /talker")
    pqsec("-k k renew /third").refused(3, "no participant /third")


def test_the_way_out_of_edited_permissions_names_the_file_and_works(pqsec, k):
    path = k / "enclaves/talker/permissions.xml"
    edited = path.read_text().replace("rt/chatter", "rt/gossip")
    path.write_text(edited)
    said = pqsec("-k k renew /talker").refused(3, f"{path.relative_to(k.parent)} is not what")
    sign = "pqsec -k k sign-permissions k/enclaves/talker/permissions.xml --force"
    assert f"`{sign}` signs what it says now" in said.err
    assert "or remove k/enclaves/talker/permissions.xml" in said.err
    pqsec(sign.removeprefix("pqsec ")).done()
    pqsec("-k k renew /talker").done()
    assert "rt/gossip" in path.read_text()


@pytest.mark.parametrize(
    ("option", "kept"), [("--keep-key", True), ("--rekey", False), ("", False)]
)
def test_renew_makes_new_keys_unless_told(pqsec, k, option, kept):
    before = (k / "enclaves/talker/key.pem").read_bytes()
    pqsec(f"-k k renew /talker {option}").done()
    assert ((k / "enclaves/talker/key.pem").read_bytes() == before) == kept


def test_renew_tells_when_it_is_cut_at_the_end_of_the_ca(pqsec, k):
    assert "when the identity CA expires" in pqsec("-k k renew /talker --validity 50y").err


# needs-renewal: step's 0 and 1 are ours too; its 2 and 255 are our 3


def test_needs_renewal_answers_by_its_exit_code(pqsec, k):
    no = pqsec("-k k needs-renewal")
    assert (no.code, no.out) == (1, "nothing needs renewal\n")
    yes = pqsec("-k k needs-renewal --due 2y")
    assert (yes.code, len(yes.out.splitlines())) == (0, 2)
    one = pqsec("-k k needs-renewal /talker --due 2y --json")
    assert (one.code, [each["name"] for each in one.json["participants"]]) == (0, ["/talker"])
    pqsec("-k k needs-renewal /nobody").refused(3, "has no participant /nobody")
    pqsec("-k nowhere needs-renewal").refused(3, "is not a pqsec keystore")
    pqsec("-k k needs-renewal --due soon").refused(2, "'soon' is not a duration")


def test_needs_renewal_speaks_of_the_list_where_nobody_is_named(pqsec, k):
    pqsec("-k k ca crl --validity 12h")
    assert pqsec("-k k needs-renewal /talker --due 1d").code == 1
    yes = pqsec("-k k needs-renewal --due 1d --json")
    assert (yes.code, yes.json["revocation_list"], yes.json["participants"]) == (0, True, [])
    done = pqsec("-k k renew --due 1d")
    assert done.code == 0
    assert "the old one was due" in done.err
    assert pqsec("-k k needs-renewal --due 1d").code == 1


# status


def test_status_shows_everybody(pqsec, k):
    pqsec("-k k revoke /talker")
    lines = pqsec("-k k status").done().out.splitlines()
    assert lines[0] == "keystore         k (profile classical)"
    assert [line.split("  ")[0] for line in lines[1:4]] == [
        "identity CA",
        "permissions CA",
        "revocation list",
    ]
    assert lines[4] == "participants     1 valid, 1 revoked"
    assert lines[6].split() == ["participant", "state", "until", "profile", "domains", "serial"]
    assert [line.split()[:2] for line in lines[7:]] == [
        ["/listener", "valid"],
        ["/talker", "revoked"],
    ]
    found = pqsec("-k k status --json --due 2y").done().json
    assert [each["state"] for each in found["participants"]] == ["due", "revoked"]
    assert found["counts"]["due"] == 1


METRIC = re.compile(r'(pqsec_\w+)(?:\{(\w+="(?:[^"\\]|\\.)*",?)*\})? (\d+)')


def test_metrics_are_in_the_text_format_and_replaced_as_a_whole(pqsec, k, tmp_path):
    pqsec("-k k status --prometheus pqsec.prom").done()
    lines = (tmp_path / "pqsec.prom").read_text().splitlines()
    samples = [METRIC.fullmatch(line) for line in lines if not line.startswith("#")]
    assert all(samples)
    assert {sample[1] for sample in samples} == {
        "pqsec_not_after_seconds",
        "pqsec_participants",
        "pqsec_status_seconds",
    }
    typed = [line.split()[2] for line in lines if line.startswith("# TYPE")]
    assert len(typed) == len(set(typed)) == 3
    assert 'pqsec_participants{state="valid"} 2' in lines
    pqsec("-k k revoke /talker")
    pqsec("-k k status --prometheus pqsec.prom").done()
    assert 'pqsec_participants{state="revoked"} 1' in (tmp_path / "pqsec.prom").read_text()
    assert [path.name for path in tmp_path.iterdir() if "prom" in path.name] == ["pqsec.prom"]


def test_metrics_replace_nothing_else(pqsec, k, tmp_path):
    (tmp_path / "mine").write_text("precious")
    pqsec("-k k status --prometheus mine").refused(
        3, "mine exists and is not a metrics file of pqsec"
    )
    pqsec("-k k status --prometheus no/folder").refused(3, "no such file")
    assert (tmp_path / "mine").read_text() == "precious"


# log


def test_log_shows_what_was_done_and_by_whom(pqsec, k):
    pqsec("-k k revoke /talker --reason superseded")
    lines = pqsec("-k k log").done().out.splitlines()
    assert lines[0].split() == ["line", "when", "who", "what", "name", "serial", "or", "hash"]
    assert "revocation (reason superseded)" in lines[-2]
    assert "crl (number 1, revoked 1)" in lines[-1]
    found = pqsec("-k k log --json").done().json["lines"]
    assert [each["number"] for each in found] == list(range(1, len(lines)))
    assert found[-2]["details"] == {"reason": "superseded"}


def test_log_verify_answers_by_its_exit_code(pqsec, k):
    good = pqsec("-k k log --verify --json").done().json
    assert good["ok"]
    pqsec("-k k issue /third --publish x")
    pqsec("-k k log --verify --head", good["head"]).done()
    pqsec("-k k log --head", "a" * 64).refused(1, "the head is not in the ledger")
    with closing(sqlite3.connect(k / "private/ledger.sqlite3")) as database:
        database.execute("DROP TRIGGER ledger_stays")
        database.execute("UPDATE ledger SET operator = 'nobody' WHERE number = 2")
        database.commit()
    pqsec("-k k log --verify").refused(1, "line 2 was altered")
    bad = pqsec("-k k log --verify --json")
    assert (bad.code, json.loads(bad.out)["ok"]) == (1, False)


def test_a_file_that_all_share_and_that_is_lost_is_named_from_where_the_user_is(pqsec, k):
    """The way out named what the link holds: restore ../governance.p7s."""
    (k / "enclaves/governance.p7s").unlink()
    hint = "restore k/enclaves/governance.p7s, which all participants share"
    pqsec("-k k bundle /talker -o talker.bundle").refused(3, "lacks governance.p7s", hint=hint)


def test_renew_and_issue_tell_of_a_governance_that_the_permissions_ca_did_not_sign(
    pqsec, k, keystore
):
    """Both exited with 0 beside a forged governance, and said nothing; nobody would start."""
    lines = ("renew /talker", "issue /new --publish a", "renew --all")
    assert [pqsec(f"-k k {line}").done().err for line in lines] == ["", "", ""]
    governance = k / "enclaves/governance.p7s"
    signed = governance.read_bytes()
    foreign = keystore(name="other", label="another") / "enclaves/governance.p7s"
    faults = {
        "foreign": foreign.read_bytes(),
        "changed": signed.replace(b">ENCRYPT<", b">NONE<"),
    }
    wrong = []
    for fault, data in faults.items():
        governance.write_bytes(data)
        for line in ("renew /talker", "issue /talker --force --publish a", "renew --all"):
            said = pqsec(f"-k k {line}")
            notes = [each for each in said.err.splitlines() if "governance.p7s" in each]
            told = [each for each in notes if "not signed by the permissions CA" in each]
            if said.code or len(notes) != 1 or not told or "sign-governance" not in notes[0]:
                wrong.append((fault, line, said))
    assert wrong == []
    governance.write_bytes((k / "enclaves/governance.xml").read_bytes())
    assert (
        "k/enclaves/governance.p7s: not signed by the permissions CA"
        in pqsec("-k k renew /talker").done().err
    )
    refused = pqsec("-k k issue /talker --force --publish a").refused(3, "not an S/MIME signed")
    assert "k/enclaves/governance.p7s" in refused.err
    [way_out] = [each for each in told[0].split("`") if each.startswith("pqsec -k k sign-gov")]
    pqsec(way_out.removeprefix("pqsec ")).done()
    assert pqsec("-k k renew /talker").done().err == ""
