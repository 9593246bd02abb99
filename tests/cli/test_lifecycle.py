"""renew, needs-renewal, revoke, ca crl, status and log, as their users run them."""

import json
import os
import re
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from pqsec_pki.cli._metrics import ListMetrics, write_metrics
from pqsec_pki.keystore import Keystore, robot_states, status


@pytest.fixture
def k(keystore):
    return keystore("classical")


def serial(pqsec, name):
    found = pqsec("-k k status --json").json["participants"]
    return next(each["serial"] for each in found if each["name"] == name)


# revoke


def test_revoke_tells_what_it_did(pqsec, k):
    number = serial(pqsec, "/talker")
    done = pqsec("-k k revoke /talker --yes --reason keyCompromise").done()
    first, second, *more = done.out.splitlines()
    assert re.fullmatch(rf"/talker  {number}  revoked \d{{4}}-\d\d-\d\d \(keyCompromise\)", first)
    assert re.fullmatch(
        r"list 1: 1 certificate, next due by \S+  k/public/identity_ca.crl.pem", second
    )
    assert "OpenDDS reads no list" in more[-1]
    done = pqsec(f"-k k revoke {number} /listener --yes --json").done()
    assert done.err == ""
    assert [each["before"] for each in done.json["revoked"]] == [True, False]
    assert [each["listed"] for each in done.json["revoked"]] == [True, True]
    assert done.json["number"] == done.json["certificates"] == 2
    assert (k / "enclaves/talker/crl.pem").read_bytes() == (k / done.json["list"][2:]).read_bytes()


def test_to_revoke_what_an_earlier_ca_issued_says_that_no_list_has_it(pqsec, k):
    number = serial(pqsec, "/talker")
    pqsec("-k k ca rotate --apply --yes --no-passphrase").done()
    done = pqsec(f"-k k --json revoke {number} --yes").done()
    assert [each["listed"] for each in done.json["revoked"]] == [False]
    assert done.json["certificates"] == 0
    assert "certificates of an earlier CA are not in a list" in done.err
    assert (k / "public/identity_ca.crl.pem").exists()


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
    assert re.fullmatch(r"/talker  until [-\d]+ [:\d]+ UTC  k/enclaves/talker\n", done.out)
    assert serial(pqsec, "/talker") != before
    assert pqsec("-k k renew --due").done().out == "nothing to renew\n"
    assert pqsec("-k k renew --due 30d --json").done().json["issued"] == []
    both = pqsec("-k k renew --due 2y --json").done().json["issued"]
    assert {each["name"] for each in both} == {"/talker", "/listener"}
    assert len(pqsec("-k k renew --all").done().out.splitlines()) == 2
    assert pqsec("-k k verify-handshake /talker /listener").code == 0


# status


def test_status_shows_everybody(pqsec, k):
    pqsec("-k k revoke /talker --yes")
    lines = pqsec("-k k status").done().out.splitlines()
    assert lines[0] == "keystore         k (profile classical)"
    assert [line.split("  ")[0] for line in lines[1:4]] == [
        "identity CA",
        "permissions CA",
        "revocation list",
    ]
    assert lines[4] == "participants     1 valid, 1 revoked"
    blank = lines.index("")
    assert lines[5].startswith("list 1           1 of 1 robots do not have list 1 yet")
    header = ["participant", "state", "until", "profile", "domains", "serial"]
    assert lines[blank + 1].split() == header
    assert [line.split()[:2] for line in lines[blank + 2 :]] == [
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
        "pqsec_ledger_whole",
        "pqsec_clock_right",
        "pqsec_not_after_seconds",
        "pqsec_participant_info",
        "pqsec_participants",
        "pqsec_status_seconds",
        "pqsec_superseded_certificates",
    }
    typed = [line.split()[2] for line in lines if line.startswith("# TYPE")]
    assert len(typed) == len(set(typed)) == 7
    place = f'keystore="{tmp_path}/k"'
    kind = 'profile="classical",domains="0"'

    def counted(state, count):
        return f'pqsec_participants{{{place},state="{state}",{kind}}} {count}'

    def info(state, robot="unknown"):
        labels = f'{place},name="/talker",state="{state}",{kind},robot="{robot}"'
        return f"pqsec_participant_info{{{labels}}} 1"

    assert {counted("valid", 2), counted("due", 0), info("valid")} <= set(lines)
    pqsec("-k k revoke /talker --yes")
    pqsec("-k k status --prometheus pqsec.prom").done()
    lines = (tmp_path / "pqsec.prom").read_text().splitlines()
    assert {counted("revoked", 1), info("revoked", "none")} <= set(lines)
    assert f'pqsec_revocation_list_robots{{{place},list="unknown"}} 1' in lines
    assert f'pqsec_revocation_list_robots{{{place},list="has"}} 0' in lines
    assert f"pqsec_ledger_whole{{{place}}} 1" in lines
    assert [path.name for path in tmp_path.iterdir() if "prom" in path.name] == ["pqsec.prom"]


def test_a_ledger_that_was_replaced_by_a_copy_is_told(pqsec, k, tmp_path):
    ledger = tmp_path / "k/private/ledger.sqlite3"
    older = ledger.read_bytes()
    pqsec("-k k issue /lost --publish x").done()
    shutil.copy(tmp_path / "k/enclaves/lost/cert.pem", tmp_path)
    shutil.rmtree(tmp_path / "k/enclaves/lost")
    assert pqsec("-k k status --json").done().json["ledger"]["faults"] == []
    pqsec("-k k check").done()
    ledger.write_bytes(older)
    told = pqsec("-k k status --prometheus pqsec.prom").done().out
    assert "ledger           NOT AS SIGNED: k/public/ledger.checkpoint: the end was cut off" in told
    assert "pqsec_ledger_whole{" in (text := (tmp_path / "pqsec.prom").read_text())
    assert re.search(r"pqsec_ledger_whole\{.*\} 0\n", text)
    found = pqsec("-k k check --json")
    assert found.code == 1
    assert [each["rule"] for each in found.json["findings"] if each["severity"] == "error"] == [
        "PQS008"
    ]
    for line in ("revoke /lost --yes", "revoke --certificate cert.pem --yes", "ca crl", "ra list"):
        pqsec(f"-k k {line}").refused(3, "the ledger lacks lines", hint="docs/how-to/anchors.md")
    (tmp_path / "k/public/ledger.checkpoint").unlink()  # the loss is accepted
    pqsec("-k k revoke /lost --yes").refused(3, "no participant")
    pqsec("-k k revoke --yes").refused(2, "nothing to revoke")
    done = pqsec("-k k revoke --certificate cert.pem --yes --json").done().json["revoked"]
    assert [(each["name"], each["listed"]) for each in done] == [("/lost", True)]
    pqsec("-k k revoke --certificate k/public/identity_ca.cert.pem --yes").refused(
        3, "is not a certificate of"
    )


def test_metrics_stay_valid_with_hostile_names(tmp_path, k):
    """The name of an adopted CA and the path of a keystore may have any character."""
    root = tmp_path / os.fsdecode(b'a "b\\\n\xff')
    k.rename(root)
    keystore = Keystore.open(root)
    standing = status(keystore, now=datetime.now(UTC))
    robots, lists = robot_states(keystore, standing.participants), ListMetrics(None, 0)
    hostile = replace(standing.shared[0], name='x"} 1\\\n\u202e\udcff\r')
    changed = replace(standing, shared=(hostile,))
    write_metrics(tmp_path / "m.prom", keystore, changed, robots, lists, is_whole=True)
    lines = (tmp_path / "m.prom").read_bytes().decode().split("\n")[:-1]
    samples = [METRIC.fullmatch(line) for line in lines if not line.startswith("#")]
    assert len(samples) > 3
    assert all(samples)
    first = next(line for line in lines if not line.startswith("#"))
    assert r'/a \"b\\\n\\xff",kind="identity-ca",name="x\"} 1\\\n' in first


# log


def test_log_shows_what_was_done_and_by_whom(pqsec, k):
    pqsec("-k k revoke /talker --yes --reason superseded")
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
        database.execute("UPDATE ledger SET details = '{\"mark\":5}' WHERE number = 5")
        database.commit()
    pqsec("-k k log --verify").refused(1, "line 2 was altered", problems=2)
    assert '(unreadable {"mark":5})' in pqsec("-k k log").done().out
    bad = pqsec("-k k log --verify --json")
    assert (bad.code, json.loads(bad.out)["ok"]) == (1, False)


def test_log_keeps_signed_heads_and_compares_the_ledger_with_them(pqsec, k, tmp_path):
    first = pqsec("-k k log --anchor anchors --json").done().json
    assert (first["unsigned"], first["already"]) == (0, False)
    assert first["anchor"] == f"anchors/{first['size']:09}.checkpoint"
    assert "was already there" in pqsec("-k k log --anchor anchors").done().out
    away = (k / "private/permissions_ca.key.pem").rename(tmp_path / "away")
    pqsec("-k k revoke /talker --yes").done()
    away.rename(k / "private/permissions_ca.key.pem")
    told = pqsec("-k k log --anchor anchors").done()
    assert "no signed head is over 2 newer lines: `pqsec log --sign` signs one" in told.err
    signed = pqsec("-k k log --sign --json").done().json
    assert signed["size"] == first["size"] + 2
    assert pqsec("-k k log --sign --anchor anchors --json").done().json["size"] == signed["size"]
    pqsec("-k k log --verify --anchor anchors").done()
    pqsec("-k k log --verify --anchor nowhere").refused(3, "nowhere is not a folder")
    for wrong in (
        "--sign --verify",
        "--anchor anchors /talker",
        "--sign --csv",
        "--sign --since 1d",
    ):
        assert pqsec(f"-k k log {wrong}").code == 2, wrong


def test_log_tells_of_a_ledger_that_differs_from_what_was_signed(pqsec, k):
    pqsec("-k k log --anchor anchors").done()
    pqsec("-k k issue /third --publish x").done()
    whole = pqsec("-k k log --anchor anchors --json").done().json["size"]
    with closing(sqlite3.connect(k / "private/ledger.sqlite3")) as database:
        database.execute("DROP TRIGGER ledger_remains")
        database.execute("DELETE FROM ledger WHERE number > ?", (whole - 1,))
        database.commit()
    for line in ("log --sign", "log --anchor anchors"):
        pqsec(f"-k k {line}").refused(1, "the end was cut off")
    found = pqsec("-k k log --verify --anchor anchors --json")
    assert found.code == 1
    assert any("those up to" in each for each in json.loads(found.out)["problems"])
    pqsec("-k k bundle /third --plain-key").refused(3, "the ledger lacks lines")
    (k / "public/ledger.checkpoint").unlink()
    note = pqsec("-k k bundle /talker --plain-key").done().err
    assert "without proof that the ledger has the documents" in note


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
    assert not any("governance" in pqsec(f"-k k {line}").done().err for line in lines)
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
    assert "governance" not in pqsec("-k k renew /talker").done().err
