"""pqsec check: what is wrong or risky, with file, line and rule."""

import json
import os
import shlex
import shutil
import subprocess
import sys

import pytest

from pqsec_pki.lint import RULES
from tests.cli.conftest import NAMES, snapshot

PERMISSIONS = "k/enclaves/talker/permissions.xml"
GOVERNANCE = "k/enclaves/governance.xml"
PLAIN_USER = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"] if os.geteuid() == 0 else []
"""Root reads everything, until it gives up the capability."""
OPEN_KEYS = "--ignore 'PQS707=CA keys of tests and demos are not encrypted'"
OPEN_KEYS_OPTION = shlex.split(OPEN_KEYS)


@pytest.fixture
def flawed(keystore, tmp_path):
    """flawed(old, new) is a keystore whose talker's permissions.xml was changed so."""

    def change(old=">DENY<", new=">ALLOW<", file=PERMISSIONS):
        keystore()
        path = tmp_path / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        return text[: text.index(old)].count("\n") + 1

    return change


@pytest.mark.parametrize("profile", NAMES)
def test_nothing_is_told_of_what_pqsec_writes(pqsec, keystore, profile):
    keystore(profile)
    result = pqsec(f"-k k check --strict --json {OPEN_KEYS}").done().json
    worse = [each for each in result["findings"] if each["severity"] != "info"]
    assert worse == []
    ours = [each for each in result["findings"] if each["rule"] < "PQS3" and each["rule"] > "PQS2"]
    assert ours == []
    assert result["ok"] is True


def test_nothing_is_told_of_the_demo(pqsec):
    pqsec("demo k")
    result = pqsec(f"-k k check --strict --json {OPEN_KEYS}").done().json
    assert [each for each in result["findings"] if each["severity"] != "info"] == []


def test_the_keystore_is_meant_where_no_path_is_named_and_nothing_is_written(
    pqsec, keystore, tmp_path
):
    keystore()
    before = snapshot(tmp_path)
    one = pqsec("check", PQSEC_KEYSTORE="k").done().out
    assert one == pqsec("check k").done().out
    assert "files checked: " in one
    assert snapshot(tmp_path) == before
    pqsec("check").refused(2, "no keystore named")


def test_a_finding_is_told_with_file_line_severity_and_rule(pqsec, flawed):
    line = flawed("<id>0</id>", "<id_range><min>0</min></id_range>")
    said = pqsec(f"check {PERMISSIONS}")
    assert said.code == 1
    assert f"{PERMISSIONS}:{line}: error PQS231 the range has no <max>" in said.out
    assert said.out.splitlines()[-2:] == [
        "1 file checked: 1 error",
        "`pqsec check --explain PQS231` explains a finding, and how to fix it",
    ]


def test_the_worst_finding_is_the_one_to_read_about(pqsec, keystore, tmp_path):
    keystore()
    pqsec("-k k issue /listener --force --publish *").done()
    (tmp_path / "k/enclaves/talker/permissions.p7s").unlink()
    found = pqsec("-k k check --json").json["findings"]
    worst = next(each["rule"] for each in found if each["severity"] == "error")
    assert found[0]["severity"] != "error"
    assert f"`pqsec check --explain {worst}` explains" in pqsec("-k k check").out


def test_warnings_make_it_a_no_with_strict_only(pqsec, flawed):
    line = flawed()
    said = pqsec(f"check {PERMISSIONS}")
    assert said.code == 0
    assert f"{PERMISSIONS}:4: warning PQS251 " in said.out
    assert line > 4
    assert pqsec(f"check --strict {PERMISSIONS}").code == 1
    assert pqsec(f"check --strict --ignore PQS251=bench {PERMISSIONS}").code == 0


def test_the_result_as_json_has_all_of_it(pqsec, flawed):
    flawed()
    result = pqsec(f"check --json --strict {PERMISSIONS}").json
    assert result["ok"] is False
    assert result["counts"] == {"error": 0, "warning": 1, "info": 0}
    [finding] = result["findings"]
    assert finding["rule"] == "PQS251"
    assert finding["path"] == PERMISSIONS
    assert finding["line"] == 4
    assert finding["fix"]
    result = pqsec(f"--json check --ignore PQS251=bench {PERMISSIONS}").done().json
    assert result["findings"] == []
    assert [each["reason"] for each in result["ignored"]] == ["bench"]


def test_the_result_as_sarif_is_one_log(pqsec, flawed):
    flawed("<id>0</id>", "<id>999</id>")
    said = pqsec(f"check --sarif {PERMISSIONS}")
    assert said.code == 1
    log = json.loads(said.out)
    assert log["version"] == "2.1.0"
    [result] = log["runs"][0]["results"]
    assert result["ruleId"] == "PQS233"
    pqsec(f"check --sarif --json {PERMISSIONS}").refused(2, "exclude each other")


def test_the_result_for_gitlab_is_a_code_quality_report(pqsec, flawed, tmp_path):
    line = flawed("<id>0</id>", "<id>999</id>")
    [issue] = json.loads(pqsec(f"check --format gitlab {PERMISSIONS}").out)
    fingerprint = issue.pop("fingerprint")
    assert issue.pop("description").startswith("domain 999")
    assert issue == {
        "check_name": "PQS233",
        "severity": "critical",
        "location": {"path": PERMISSIONS, "lines": {"begin": line}},
    }
    edit(tmp_path / PERMISSIONS, "<domains>", "<domains>\n")
    [moved] = json.loads(pqsec(f"check --format gitlab {PERMISSIONS}").out)
    assert moved["location"]["lines"]["begin"] == line + 1
    assert moved["fingerprint"] == fingerprint
    pqsec(f"check --format gitlab --json {PERMISSIONS}").refused(2, "exclude each other")
    pqsec(f"check --format gitlab --sarif {PERMISSIONS}").refused(2, "exclude each other")


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def baseline_of(pqsec, tmp_path, words):
    (tmp_path / "baseline.json").write_text(pqsec(f"check --json {words}").out)


def test_what_is_in_the_baseline_does_not_count_and_what_is_new_does(pqsec, flawed, tmp_path):
    flawed("<id>0</id>", "<id>999</id>")
    baseline_of(pqsec, tmp_path, PERMISSIONS)
    old = f"check --baseline baseline.json {PERMISSIONS}"
    assert pqsec(f"check {PERMISSIONS}").code == 1
    done = pqsec(f"{old} --json").done().json
    assert [each["reason"] for each in done["ignored"]] == ["in the baseline"]
    edit(tmp_path / PERMISSIONS, "<domains>", "<domains>\n\n")
    assert "no findings, 1 ignored" in pqsec(old).done().out
    edit(tmp_path / PERMISSIONS, "<id>999</id>", "<id>999</id><id>998</id>")
    said = pqsec(old)
    assert said.code == 1
    assert "999" not in said.out


def test_a_second_finding_like_one_of_the_baseline_is_new(pqsec, flawed, tmp_path):
    flawed("<id>0</id>", "<id>999</id>")
    baseline_of(pqsec, tmp_path, PERMISSIONS)
    edit(tmp_path / PERMISSIONS, "<id>999</id>", "<id>999</id><id>999</id>")
    said = pqsec(f"check --baseline baseline.json {PERMISSIONS}")
    assert said.code == 1
    assert "1 error, 1 ignored" in said.out


def test_what_is_gone_from_the_baseline_is_noted(pqsec, flawed, tmp_path):
    flawed("<id>0</id>", "<id>999</id>")
    baseline_of(pqsec, tmp_path, PERMISSIONS)
    edit(tmp_path / PERMISSIONS, "<id>999</id>", "<id>0</id>")
    done = pqsec(f"check --baseline baseline.json {PERMISSIONS}").done()
    assert "1 finding of the baseline no longer found" in done.err


def test_what_cannot_be_read_is_not_old(keystore, tmp_path):
    keystore()
    closed = "k/enclaves/talker/cert.pem"
    check = ["k/enclaves", "--json"]
    before = as_plain_user(tmp_path, closed, 0, *check)
    (tmp_path / "baseline.json").write_text(before.stdout)
    assert any(each["path"] == closed for each in json.loads(before.stdout)["findings"])
    after = as_plain_user(tmp_path, closed, 0, *check, "--baseline", "baseline.json")
    assert after.returncode == 3


NO_BASELINES = ["", "{}", "[]", "no", '{"findings": 1}', '{"findings": [{}]}', "[" * 10**5]
NO_BASELINES += ['{"findings": [{"rule": [], "path": 1, "message": null}]}', "\udcff"]


@pytest.mark.parametrize("text", NO_BASELINES, ids=range(len(NO_BASELINES)))
def test_what_is_no_baseline_is_refused(pqsec, flawed, tmp_path, text):
    flawed()
    (tmp_path / "b.json").write_text(text, errors="surrogateescape")
    pqsec(f"check --baseline b.json {PERMISSIONS}").refused(3, "b.json: not a baseline")


def test_only_the_stacks_that_are_meant_are_asked(pqsec, flawed):
    flawed("<id>0</id>", "<id>999</id>")
    assert pqsec(f"check --target fastdds {PERMISSIONS}").code == 0
    assert pqsec(f"check --target fastdds,cyclonedds {PERMISSIONS}").code == 1
    pqsec(f"check --target fast {PERMISSIONS}").refused(2, "'fast' is not one of cyclonedds")


def test_ros_2_asks_for_the_topics_a_node_needs(pqsec, keystore):
    keystore()
    assert "may not publish ros_discovery_info" in pqsec(f"check --target ros2 {PERMISSIONS}").out


def test_a_suppression_file_beside_the_files_is_read(pqsec, flawed, tmp_path):
    flawed()
    text = "ignore:\n- rule: PQS251\n  path: enclaves/talker/*\n  reason: bench\n"
    (tmp_path / "k/.pqsec-check.yaml").write_text(text)
    said = pqsec("check k").done()
    assert "PQS251" not in said.out
    assert "1 ignored" in said.out


def test_a_rule_is_explained(pqsec):
    said = pqsec("check --explain pqs401").done().out
    assert said.startswith("PQS401 (error, naming): ")
    assert "CN=/robot/admin" in said
    assert "To fix it: " in said
    told, rule = pqsec("check --explain PQS401 --json").done().json, RULES["PQS401"]
    assert (told["rule"], told["bad"], told["good"]) == (rule.id, rule.bad, rule.good)
    pqsec("check --explain PQS999").refused(2, "no rule PQS999")


@pytest.mark.parametrize("id_", RULES)
def test_every_rule_can_be_explained(pqsec, id_):
    assert RULES[id_].fix in pqsec(f"check --explain {id_}").done().out


def test_what_cannot_be_asked_for_is_refused(pqsec, keystore):
    keystore()
    pqsec("check nowhere").refused(3, "nowhere: no such file")
    pqsec("check k --ignore PQS401").refused(2, "no reason given")
    pqsec("check k --ignore PQS999=x").refused(2, "no rule PQS999")
    pqsec("check ''").refused(2)


def test_control_characters_of_a_document_do_not_reach_a_terminal(pqsec, flawed):
    flawed("rt/chatter", "[^\u009b2J\u202e]")
    said = pqsec(f"check {PERMISSIONS}")
    assert said.code == 1
    assert said.out.replace("\n", "").isprintable()


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ("cyclonedds", set()),
        ("fastdds", {"PQS501"}),  # some versions cannot send so large a handshake
        ("opendds", {"PQS230"}),  # makes no participant with such governance
        ("connext", set()),
        ("ros2", {"PQS268"}),  # the participants were not issued as nodes
    ],
)
def test_of_what_pqsec_writes_each_stack_is_told_what_does_not_suit_it(
    pqsec, keystore, target, told
):
    keystore("transition")
    result = pqsec(f"-k k check --json --target {target} {OPEN_KEYS}").json
    worse = {each["rule"] for each in result["findings"] if each["severity"] != "info"}
    assert worse == told


def as_plain_user(folder, closed, mode, *options):
    """The output of `pqsec check` for a user who may not read that."""
    (folder / closed).chmod(mode)
    done = subprocess.run(
        [*PLAIN_USER, sys.executable, "-m", "pqsec_pki", "check", *options],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    (folder / closed).chmod(0o700)
    return done


@pytest.mark.parametrize(
    ("closed", "mode", "told"),
    [
        ("k/enclaves/talker/permissions.xml", 0, {"k/enclaves/talker/permissions.xml"}),
        ("k/enclaves/talker", 0, {"k/enclaves/talker"}),
        ("k/enclaves/talker", 0o600, {"k/enclaves/talker"}),
        ("k/enclaves", 0o600, {"k/enclaves"}),
    ],
)
def test_what_is_closed_to_the_user_is_told_and_not_checked(keystore, tmp_path, closed, mode, told):
    keystore()
    done = as_plain_user(tmp_path, closed, mode, "k", "--json")
    assert done.stderr == ""
    findings = json.loads(done.stdout)["findings"]
    assert {each["path"] for each in findings if each["rule"] == "PQS001"} == told


@pytest.mark.parametrize("path", ["k", "k/enclaves/talker"])
def test_a_link_to_what_is_closed_is_not_told_as_leading_nowhere(keystore, tmp_path, path):
    keystore("transition")
    done = as_plain_user(tmp_path, "k/public", 0, path, "--json")
    findings = json.loads(done.stdout)["findings"]
    unread = {each["path"] for each in findings if each["rule"] == "PQS001"}
    assert {each["rule"] for each in findings} <= {"PQS001", "PQS707"}
    links = ("identity_ca.cert.pem", "permissions_ca.cert.pem", "permissions_ca.alt.cert.pem")
    assert {f"k/enclaves/talker/{name}" for name in links} <= unread


def test_a_link_to_what_is_not_there_leads_nowhere_still(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "k/public/identity_ca.cert.pem").unlink()
    found = json.loads(pqsec("--json check k").out)["findings"]
    told = {each["path"] for each in found if each["rule"] == "PQS302"}
    assert "k/enclaves/talker/identity_ca.cert.pem" in told


def test_a_check_that_could_not_read_everything_does_not_pass_for_clean(keystore, tmp_path):
    keystore()
    for closed in ("k/enclaves", "k/enclaves/talker", "k/enclaves/talker/key.pem", "k/public"):
        done = as_plain_user(tmp_path, closed, 0, "k", *OPEN_KEYS_OPTION)
        assert (closed, done.returncode) == (closed, 3)
        assert "incomplete: " in done.stdout
        value = json.loads(as_plain_user(tmp_path, closed, 0, "k", "--json").stdout)
        assert (value["ok"], value["incomplete"]) == (False, True)


def test_the_closed_folder_of_the_ca_keys_leaves_a_check_complete(keystore, tmp_path):
    keystore()
    done = as_plain_user(tmp_path, "k/private", 0, "k", "--json")
    value = json.loads(done.stdout)
    assert (done.returncode, value["ok"], value["incomplete"]) == (0, True, False)
    assert [each["path"] for each in value["findings"] if each["rule"] == "PQS001"] == ["k/private"]
    (tmp_path / "private").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "k/enclaves/talker/permissions.xml").rename(tmp_path / "other/permissions.xml")
    (tmp_path / "private").rename(tmp_path / "other/private")
    assert as_plain_user(tmp_path, "other/private", 0, "other").returncode == 3


def test_an_error_is_a_no_whatever_else_could_not_be_read(flawed, tmp_path):
    flawed("<id>0</id>", "<id>x</id>")
    done = as_plain_user(tmp_path, "k/enclaves/listener", 0, "k")
    assert done.returncode == 1
    assert "incomplete: " in done.stdout


def test_what_may_stay_unread_for_a_reason_leaves_a_check_complete(keystore, tmp_path):
    keystore()
    options = ("--ignore", "PQS001=keys are their owners'")
    done = as_plain_user(tmp_path, "k/enclaves/talker/key.pem", 0, "k", "--json", *options)
    assert (done.returncode, json.loads(done.stdout)["incomplete"]) == (0, False)


@pytest.mark.parametrize(
    ("closed", "mode"), [("k", 0), ("k", 0o600), ("k/enclaves/talker/permissions.xml", 0)]
)
def test_what_is_named_and_closed_is_an_error(keystore, tmp_path, closed, mode):
    keystore()
    done = as_plain_user(tmp_path, closed, mode, closed)
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr == f"pqsec: error: {closed}: permission denied\n"


def test_why_credentials_are_not_trusted_is_told_as_a_code(pqsec, keystore, tmp_path):
    keystore()
    ca = tmp_path / "k/public/identity_ca.cert.pem"
    ca.write_bytes(ca.read_bytes() * 2)
    found = json.loads(pqsec("--json check k").out)["findings"]
    assert {each["code"] for each in found if each["rule"] == "PQS319"} == {"ca-doubled"}
    [run] = json.loads(pqsec("check k --sarif").out)["runs"]
    results = [each for each in run["results"] if each["ruleId"] == "PQS319"]
    assert {each["properties"]["code"] for each in results} == {"ca-doubled"}


def test_a_keystore_that_lost_its_settings_or_its_ledger_is_told_as_that(pqsec, keystore, tmp_path):
    """Without pqsec.json the check went on as if nothing were missing."""
    k = keystore()

    def told(*lost):
        shutil.copytree(k, tmp_path / "k2", symlinks=True)
        for each in lost:
            path = tmp_path / "k2" / each
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        findings = pqsec("check k2 --json").json["findings"]
        shutil.rmtree(tmp_path / "k2")
        return [(each["path"], each["message"]) for each in findings if each["rule"] == "PQS007"]

    words = "the keystore lacks {}: the rules that need it were not checked"
    ledger = "private/ledger.sqlite3"
    assert told() == []
    assert told("pqsec.json") == [("k2", words.format("pqsec.json"))]
    assert told(ledger) == [("k2", words.format(ledger))]
    assert told("private") == [("k2", words.format(f"private, {ledger}"))]
    # A robot's copy, and a keystore of SROS2's, which has private/ and neither of the others.
    assert told("pqsec.json", "private") == []
    assert told("pqsec.json", ledger) == []
