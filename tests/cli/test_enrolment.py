"""pqsec request, issue --csr, bundle, install, rollback and sign-request, as users run them."""

import json
import shutil
import stat
import time
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from pqsec_pki.cli import _settings
from tests.cli.conftest import NAMES, snapshot

ROBOT = "/fleet/robot1"
CSR = "requests/fleet+robot1/request.csr"
TOPIC = "--publish telemetry"
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
POLICY = """
domains: 0
validity: 1y
grants:
  - name: /fleet/robot1
    publish: [from/a/policy]
"""


@pytest.fixture
def asked(pqsec, keystore, tmp_path):
    """asked("pq") is a keystore `k` of that profile, and a robot `r` that has asked."""

    def make(profile="classical"):
        keystore(profile)
        pqsec(f"request {ROBOT} --profile {profile} --dir r").done()
        return tmp_path / "r"

    return make


def fingerprints(pqsec):
    return " ".join(pqsec("-k k ca show --pins").done().out.split())


@pytest.mark.parametrize("profile", NAMES)
def test_a_robot_asks_is_answered_and_runs_with_it(pqsec, asked, profile):
    robot = asked(profile)
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC}").done()
    found = pqsec(f"install fleet+robot1.bundle --dir r --json {fingerprints(pqsec)}").done().json
    assert found["installed"] == [ROBOT]
    assert not found["already"]
    folder = robot / f"current/enclaves{ROBOT}"
    pqsec(f"check --strict {folder}").done()
    assert stat.S_IMODE((folder / "key.pem").stat().st_mode) == 0o600
    assert not list((robot.parent / f"k/enclaves{ROBOT}").glob("*key.pem"))
    found = pqsec("-k k check --json").done().json["findings"]
    problems = [each for each in found if each["severity"] != "info"]
    assert not [each for each in problems if "fleet/robot1" in each["path"]]


def test_the_installed_enclave_meets_another_one(pqsec, asked, tmp_path):
    """With the keys of the robot put beside the rest, as nobody else can."""
    robot = asked("transition")
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} --publish rt/chatter").done()
    pqsec("install fleet+robot1.bundle --dir r --trust-first").done()
    enclave = tmp_path / f"k/enclaves{ROBOT}"
    shutil.rmtree(enclave)
    shutil.copytree(robot / f"current/enclaves{ROBOT}", enclave)
    pqsec(f"-k k verify-handshake {ROBOT} /listener").done()


def test_several_requests_have_a_bundle_each(pqsec, asked, tmp_path):
    asked()
    pqsec("request /fleet/robot2 --profile classical --dir r2").done()
    files = f"--csr r/{CSR} --csr r2/requests/fleet+robot2/request.csr"
    line = f"-k k issue {files} --allow-name '/fleet/*' --bundles out {TOPIC} --json"
    found = pqsec(line).done().json["issued"]
    assert [each["bundle"] for each in found] == [
        *("out/fleet+robot1.bundle", "out/fleet+robot2.bundle"),
    ]
    assert len(list((tmp_path / "out").iterdir())) == 2


TWELVE = [f"/tb3/node{number}" for number in range(12)]


def test_a_robot_of_twelve_nodes_requests_and_is_answered_in_one_file_each(pqsec, asked, tmp_path):
    asked()
    line = f"request {' '.join(TWELVE)} --profile classical --dir r --csr tb3.csr"
    found = pqsec(f"{line} --json").done().json
    assert [each["name"] for each in found["requests"]] == TWELVE
    assert found["csr"] == "tb3.csr"
    pqsec(f"-k k issue --csr tb3.csr --allow-name '/tb3/*' --bundles out {TOPIC}").done()
    pqsec("-k k bundle '/tb3/*' -o tb3.bundle").done()
    found = pqsec(f"install tb3.bundle --dir r --json {fingerprints(pqsec)}").done().json
    assert sorted(found["installed"]) == sorted(TWELVE)
    assert (tmp_path / f"r/{CSR}").exists()  # of another participant, not answered yet


def test_requests_in_one_file_go_to_cas_offline_together(pqsec, asked):
    asked()
    pqsec("request /tb3/nav /tb3/arm --profile classical --dir r --csr tb3.csr").done()
    pqsec(f"sign-request export tb3.csr {TOPIC} -o asked").done()
    pqsec("-k k sign-request sign asked --allow-name '/tb3/*' -o answer").done()
    line = f"sign-request import answer --request asked --bundles out {fingerprints(pqsec)} --json"
    found = pqsec(line).done().json["bundles"]
    assert sorted(each["name"] for each in found) == ["/tb3/arm", "/tb3/nav"]


def test_a_pattern_requests_new_keys_for_all_that_a_robot_has(pqsec, asked, tmp_path):
    asked()
    installed = f"-k k issue --csr tb3.csr --allow-name '/tb3/*' --bundles out {TOPIC}"
    pqsec("request /tb3/nav --profile classical --dir r --csr tb3.csr").done()
    pqsec(installed).done()
    pqsec("install out/tb3+nav.bundle --dir r --trust-first").done()
    pqsec("request /tb3/arm --profile classical --dir r").done()
    line = "request '/tb3/*' --profile classical --dir r --csr tb3.csr"
    before = snapshot(tmp_path / "r")
    pqsec(line).refused(3, "tb3.csr exists")
    pqsec(line.replace("tb3.csr", "new.csr")).refused(3, "tb3+arm exists")
    assert snapshot(tmp_path / "r") == before
    assert not (tmp_path / "new.csr").exists()
    found = pqsec(f"{line} --force --json").done().json["requests"]
    assert [each["name"] for each in found] == ["/tb3/arm", "/tb3/nav"]
    pqsec(f"{installed} --force").done()
    for name in ("nav", "arm"):
        pqsec(f"install out/tb3+{name}.bundle --dir r").done()


@pytest.mark.parametrize(
    ("names", "code", "words"),
    [
        ("'/none/*'", 3, "no participant matches /none/*"),
        ("@group", 3, "there is no group @group"),
        ("/new /fleet/robot1", 3, "fleet+robot1 exists"),
        ("/new 'a b'", 2, "cannot be a participant's name"),
        ("", 2, "Missing argument"),
    ],
)
def test_of_several_requests_all_are_made_or_none(pqsec, asked, names, code, words):
    robot = asked()
    before = snapshot(robot)
    line = f"request {names} --profile classical --dir r --csr all.csr"
    pqsec(line).refused(code, words)
    assert snapshot(robot) == before
    assert not (robot.parent / "all.csr").exists()


def test_a_file_of_requests_with_one_that_is_not_allowed_is_not_answered(pqsec, asked, tmp_path):
    asked()
    pqsec("request /tb3/nav /other --profile classical --dir r --csr all.csr").done()
    line = "-k k issue --allow-name '/tb3/*' --csr"
    before = snapshot(tmp_path / "k")
    pqsec(f"{line} all.csr {TOPIC}").refused(1, "CN=/other: its name is not one of the allowed")
    whole = (tmp_path / "all.csr").read_bytes()
    (tmp_path / "broken.csr").write_bytes(whole[:-80])
    pqsec(f"{line} broken.csr {TOPIC}").refused(3, "broken.csr: certificate request: broken PEM")
    (tmp_path / "twice.csr").write_bytes(whole * 2)
    pqsec(f"sign-request export twice.csr {TOPIC} -o x").refused(2, "have the same name")
    assert snapshot(tmp_path / "k") == before


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("issue", 2, "no participant named"),
        ("issue /x --allow-name '/*'", 2, "need requests"),
        ("issue /x --bundles out", 2, "need requests"),
        (f"issue --csr r/{CSR}", 2, "must not choose its own name"),
        (f"issue --csr r/{CSR} /other", 1, "not one of the allowed names"),
        (f"issue --csr r/{CSR} --allow-name '/*'", 1, "not one of the allowed names"),
        (f"issue --csr r/{CSR} --csr r/{CSR} {ROBOT}", 1, "2 requests are for"),
        (f"issue --csr nowhere {ROBOT}", 3, "nowhere: no such file"),
        (f"issue --csr k/public/identity_ca.cert.pem {ROBOT}", 3, "no certificate request"),
        (f"issue --csr r/{CSR} {ROBOT} --seal-for r/{CSR}", 3, "no public key to seal for"),
        ("bundle", 2, "no participant named"),
        ("bundle /talker", 2, "has private keys of /talker"),
        ("bundle /talker --plain-key --no-keys", 2, "excludes"),
        ("bundle /nobody --plain-key", 3, "no participant /nobody"),
        ("bundle --robot k/public", 2, "is a directory"),
    ],
)
def test_what_cannot_be_done_is_refused_and_leaves_nothing(pqsec, asked, line, code, words):
    here = asked().parent
    before = snapshot(here / "k")
    problems = 2 if "/other" in line else 1
    result = pqsec(f"-k k {line}")
    result.refused(code, words, problems=problems)
    assert snapshot(here / "k") == before
    assert not list(here.glob("*.bundle"))


def test_a_bundle_that_is_there_is_not_overwritten_and_nothing_is_issued(pqsec, asked, tmp_path):
    asked()
    (tmp_path / "fleet+robot1.bundle").write_text("mine")
    before = snapshot(tmp_path / "k")
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT}").refused(3, "exists", hint="--force")
    assert snapshot(tmp_path / "k") == before
    assert (tmp_path / "fleet+robot1.bundle").read_text() == "mine"
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC} --force").done()
    pqsec("install fleet+robot1.bundle --dir r --trust-first").done()


def test_a_bundle_that_cannot_be_written_can_be_made_later(pqsec, asked):
    asked()
    line = f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC} --bundles k/pqsec.json/out"
    result = pqsec(line).refused(3, "pqsec.json", hint=f"`pqsec bundle {ROBOT}`")
    assert "issued" in result.err
    pqsec(f"-k k bundle {ROBOT}").done()
    pqsec("install fleet+robot1.bundle --dir r --trust-first").done()


@pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning")
@pytest.mark.parametrize(
    ("oid", "value"),
    [
        (x509.NameOID.ORGANIZATION_NAME, "Lab"),
        (x509.NameOID.COMMON_NAME, "robot1"),
        (x509.NameOID.COMMON_NAME, "/fleet/../robot1"),
        (x509.NameOID.COMMON_NAME, "/fleet/robot1\0"),
        (x509.NameOID.COMMON_NAME, "/fleet/robot1\x1b[2K"),
        (x509.NameOID.COMMON_NAME, "/fl\u0435et/robot1"),  # a Cyrillic letter
        (x509.NameOID.COMMON_NAME, "/fleet/"),
        (x509.NameOID.COMMON_NAME, f"/{'x' * 64}"),
        (x509.NameOID.COMMON_NAME, f"/{'x' * 300}"),
    ],
)
def test_a_request_without_a_participants_name_is_not_exported(pqsec, tmp_path, oid, value):
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(oid, value, _validate=False)])
    made = x509.CertificateSigningRequestBuilder().subject_name(name).sign(key, hashes.SHA256())
    (tmp_path / "csr").write_bytes(made.public_bytes(Encoding.PEM))
    pqsec("sign-request export csr -o x").refused(1, "not the CN of a participant alone")
    assert not (tmp_path / "x").exists()


def test_keys_made_here_travel_sealed_or_because_you_said_so(pqsec, keystore, tmp_path):
    keystore("transition")
    sha256 = pqsec("bundle-key --dir r --json").done().json["sha256"]
    pqsec("-k k bundle /talker /listener --seal-for r/bundle.pub.pem -o b").done()
    secret = (tmp_path / "k/enclaves/talker/key.pem").read_bytes()
    assert secret not in (tmp_path / "b").read_bytes()
    found = pqsec("install b --dir r --trust-first --json").done().json
    assert found["installed"] == ["/talker", "/listener"]
    assert (tmp_path / "r/current/enclaves/talker/key.pem").read_bytes() == secret
    pqsec("install b --dir twin --trust-first").refused(3, "no key to open it")
    assert not (tmp_path / "twin").exists()
    pqsec("bundle-key --dir twin").done()
    refused = pqsec("install b --dir twin --trust-first").refused(1, "sealed for another key")
    assert sha256 not in refused.err
    plain = pqsec("-k k bundle /talker --plain-key").done()
    assert "without encryption" in plain.err
    assert stat.S_IMODE((tmp_path / "talker.bundle").stat().st_mode) == 0o600
    pqsec("-k k bundle /talker --no-keys -o public").done()
    assert stat.S_IMODE((tmp_path / "public").stat().st_mode) == 0o644


def test_keys_of_all_robots_are_not_sealed_for_one(pqsec, keystore, tmp_path):
    keystore("classical")
    pqsec("bundle-key --dir r").done()
    line = "-k k bundle --outdated --seal-for r/bundle.pub.pem"
    pqsec(f"{line} --bundles out").refused(2, "one robot", hint="names")
    assert not (tmp_path / "out").exists()
    pqsec(f"{line} /talker --bundles out").done()


def test_a_bundle_that_its_robot_would_refuse_is_not_written(pqsec, keystore, tmp_path):
    keystore()
    pqsec("-k k revoke /talker --yes").done()
    pqsec("-k k bundle /listener --plain-key").done()
    pqsec("-k k bundle /talker --plain-key").refused(1, "/talker", "was revoked on")
    assert not (tmp_path / "talker.bundle").exists()


def test_a_file_can_name_the_participants_of_a_robot(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "robot7").write_text("# seven\n/talker  # its mouth\n\n/listener\n")
    found = pqsec("-k k bundle --robot robot7 --plain-key --json").done().json
    assert found["names"] == ["/talker", "/listener"]
    assert found["bundle"] == "talker.bundle"
    (tmp_path / "empty").write_text("# nobody\n")
    pqsec("-k k bundle --robot empty").refused(3, "does not name a participant")


def test_the_way_back(pqsec, asked, tmp_path):
    robot = asked()
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC}").done()
    pqsec("install fleet+robot1.bundle --dir r --trust-first").done()
    first = (robot / f"current/enclaves{ROBOT}/cert.pem").read_bytes()
    pqsec("rollback --dir r").refused(3, "has no installation from before")
    time.sleep(1.01)  # certificates and signatures know whole seconds
    pqsec(f"-k k renew {ROBOT}").done()
    pqsec(f"-k k bundle {ROBOT} --force").done()
    pqsec("install fleet+robot1.bundle --dir r").done()
    assert (robot / f"current/enclaves{ROBOT}/cert.pem").read_bytes() != first
    again = pqsec("install fleet+robot1.bundle --dir r --json").done().json
    assert again["already"]
    assert "older than one installed before" in pqsec("rollback --dir r").err
    assert (robot / f"current/enclaves{ROBOT}/cert.pem").read_bytes() != first
    pqsec("rollback --dir r --older").done()
    assert (robot / f"current/enclaves{ROBOT}/cert.pem").read_bytes() == first
    pqsec("rollback --dir nowhere").refused(3, "nothing is installed")


def test_a_robots_clock_that_was_ahead_or_is_in_1970_is_noted_and_hides_no_receipt(
    pqsec, asked, tmp_path, monkeypatch
):
    asked("classical")
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC}").done()
    now = _settings.now()
    for day, words in ((now + timedelta(days=30), "in the future"), (EPOCH, "before its cert")):
        with monkeypatch.context() as robot:
            robot.setattr(_settings, "now", lambda day=day: day)
            pqsec("install fleet+robot1.bundle --dir r --trust-first").done()
        done = pqsec("-k k receipt import r/installed.receipt").done()
        assert words in done.err
        assert "check the robot's clock" in done.err
        assert "recorded: bundle" in done.out
    shutil.copytree(tmp_path / "r", tmp_path / "backup", symlinks=True)
    for folder in ("r", "backup"):
        pqsec(f"install fleet+robot1.bundle --dir {folder}").done()
    pqsec("-k k receipt import r/installed.receipt").done()
    line = "-k k receipt import backup/installed.receipt"
    pqsec(line).refused(1, "receipt 3 of its store; receipt 3 is recorded", hint="--older")
    told = pqsec(f"{line} --older --json").done().json
    assert [(each["number"], each["clock"]) for each in told["receipts"]] == [(3, None)]


def test_the_configuration_of_a_stack_is_for_where_the_keys_are(pqsec, asked, tmp_path):
    asked("classical")
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC}").done()
    pqsec(f"-k k export cyclonedds {ROBOT}").refused(3, "lacks key.pem", hint="--at")
    at = f"/etc/dds/current/enclaves{ROBOT}"
    text = pqsec(f"-k k export cyclonedds {ROBOT} --at {at}").done().out
    assert f"file://{at}/key.pem" in text
    pqsec(f"-k k verify-handshake {ROBOT} /talker --json")
    pqsec("-k k check").done()


def test_ros_2_gets_the_script_alone_if_the_robot_has_its_keys(pqsec, asked, tmp_path):
    asked("classical")
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC} --ros-node {ROBOT}").done()
    line = "-k k export ros2 '/fleet/*' --at /opt/fleet/current/enclaves -o out"
    assert "copy ros2.sh to its robot, which has its keys" in pqsec(line).done().err
    assert [each.name for each in (tmp_path / f"out{ROBOT}").iterdir()] == ["ros2.sh"]


def test_what_is_installed_on_a_robot_is_no_keystore(pqsec, asked):
    asked("classical")
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC}").done()
    pqsec("install fleet+robot1.bundle --dir r --trust-first").done()
    hint = "`pqsec check r/current` checks it"
    pqsec("-k r/current status").refused(3, "not a pqsec keystore", hint=hint)
    pqsec("check r/current").done()


# CAs without a network


def test_an_offline_ca_answers_and_may_be_asked_again(pqsec, asked, tmp_path):
    asked("transition")
    line = f"sign-request export r/{CSR} {TOPIC} --validity 30d -o asked --json"
    sha256 = pqsec(line).done().json["sha256"]
    shown = pqsec(f"-k k sign-request sign asked --show --sha256 {sha256} --json").done().json
    assert shown["participants"] == [
        {
            "name": ROBOT,
            "domains": "0",
            "publish": ["telemetry"],
            "subscribe": [],
            "policy": False,
            "permissions": None,
            "hours": 720,
        }
    ]
    assert pqsec("-k k sign-request sign asked -o answer").done().out.startswith(ROBOT)
    before = json.dumps(pqsec("-k k log --json").done().json)
    pqsec("-k k sign-request sign asked -o answer").refused(3, "answer exists")
    pqsec("-k k sign-request sign asked -o again").done()
    assert json.dumps(pqsec("-k k log --json").done().json) == before
    pins = fingerprints(pqsec)
    for answer, already in (("answer", False), ("again", True)):
        line = f"sign-request import {answer} --request asked --bundles out {pins} --json"
        [found] = pqsec(line).done().json["bundles"]
        assert found["already"] == already
    pqsec(f"install out/fleet+robot1.bundle --dir r {pins}").done()


def test_what_is_asked_for_shows_before_it_is_signed(pqsec, asked, tmp_path):
    """The permissions of a policy, and no topic that paints over another on the terminal."""
    asked("classical")
    (tmp_path / "policy.yaml").write_text(POLICY)
    pqsec(f"sign-request export r/{CSR} --policy policy.yaml -o policed").done()
    said = pqsec("-k k sign-request sign policed --show").done().out
    assert "<topic>from/a/policy</topic>" in said
    pqsec(f"sign-request export r/{CSR} -o asked --publish", "evil\x1b[2K\r").done()
    said = pqsec("-k k sign-request sign asked --show").done().out
    assert "evil\\u001b[2K\\u000d" in said
    assert "\x1b" not in said


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("sign-request export nowhere -o x", 3, "no such file"),
        (f"sign-request export r/{CSR} r/{CSR} -o x", 2, "two requests have the same name"),
        ("-k k sign-request sign asked", 2, "no output file named"),
        ("-k k sign-request sign asked -o x --sha256 00", 1, "its SHA-256 is"),
        ("-k k sign-request sign asked -o x --allow-name '/arm/*'", 1, "not one of the allowed"),
        (f"-k k sign-request sign r/{CSR} -o x", 3, "not an archive of pqsec"),
        ("sign-request import asked --request asked", 3, "a sign request, not a sign answer"),
        (f"sign-request import asked --request r/{CSR}", 3, "not an archive of pqsec"),
    ],
)
def test_what_cannot_be_signed_or_imported_is_refused(pqsec, asked, line, code, words):
    here = asked("classical").parent
    pqsec(f"sign-request export r/{CSR} {TOPIC} -o asked").done()
    before = snapshot(here / "k")
    pqsec(line).refused(code, words)
    assert snapshot(here / "k") == before
    assert not (here / "x").exists()


def test_a_stolen_key_is_not_certified_again_unless_that_risk_is_taken(pqsec, asked, tmp_path):
    robot = asked()
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC}").done()
    pqsec(f"-k k revoke {ROBOT} --yes --reason keyCompromise").done()
    line = f"-k k issue --csr k/enclaves{ROBOT}/request.pem {ROBOT} {TOPIC} --force"
    again = f"{line} --after-revocation"
    pqsec(again).refused(1, f"{ROBOT}: its key was revoked as compromised", hint="`pqsec request`")
    (robot.parent / "fleet+robot1.bundle").unlink()
    pqsec(f"{again} --reuse-compromised-key").done()
    pqsec(f"-k k renew {ROBOT}").refused(1, "compromised", hint="`pqsec request`")
    pqsec(f"-k k renew {ROBOT} --reuse-compromised-key").done()


def test_the_air_gap_lets_no_stolen_key_through(pqsec, asked):
    asked()
    pqsec(f"-k k issue --csr r/{CSR} {ROBOT} {TOPIC}").done()
    pqsec(f"-k k revoke {ROBOT} --yes --reason keyCompromise").done()
    pqsec(f"sign-request export r/{CSR} {TOPIC} -o asked").done()
    line = "-k k sign-request sign asked -o answer --force --after-revocation"
    pqsec(line).refused(1, "its key was revoked as compromised")
    pqsec(f"{line} --reuse-compromised-key").done()


def test_a_robot_of_two_participants_keeps_both(pqsec, asked, tmp_path):
    asked()
    pqsec("request /fleet/arm --profile classical --dir r").done()
    folder = "r/requests/fleet+"
    pqsec(f"-k k issue --csr {folder}arm/request.csr /fleet/arm {TOPIC}").done()
    pqsec(f"-k k issue --csr {folder}robot1/request.csr {ROBOT} {TOPIC}").done()
    pqsec(f"install fleet+arm.bundle --dir r {fingerprints(pqsec)}").done()
    pqsec("install fleet+robot1.bundle --dir r").done()
    enclaves = tmp_path / "r/current/enclaves/fleet"
    assert sorted(each.name for each in enclaves.iterdir()) == ["arm", "robot1"]
    line = "install fleet+robot1.bundle --dir r --only"
    pqsec(line).refused(2, "/fleet/arm would be removed", hint="--yes", shows="remove: /fleet/arm")
    assert sorted(each.name for each in enclaves.iterdir()) == ["arm", "robot1"]
    pqsec(f"{line} --yes").done()
    assert [each.name for each in enclaves.iterdir()] == ["robot1"]
    pqsec(line).done()  # nothing to remove: no question
    assert [each.name for each in enclaves.iterdir()] == ["robot1"]


@pytest.mark.parametrize(("validity", "told"), [("12h", "12h"), ("36h", "36h"), ("90d", "90d")])
def test_who_signs_is_told_for_how_long_to_the_hour(pqsec, asked, validity, told):
    asked()
    pqsec(f"sign-request export r/{CSR} {TOPIC} --validity {validity} -o asked").done()
    [row] = [
        line
        for line in pqsec("-k k sign-request sign asked --show").done().out.splitlines()
        if line.startswith(ROBOT)
    ]
    assert row.split()[-1] == told


def test_an_import_takes_fingerprints_as_people_write_them(pqsec, asked):
    asked()
    pqsec(f"sign-request export r/{CSR} {TOPIC} -o asked").done()
    pqsec("-k k sign-request sign asked -o answer").done()
    line = "sign-request import answer --request asked"
    pins = fingerprints(pqsec)
    pqsec(f"{line} {pins[:-1]}").refused(2, "is not a role and a SHA-256 fingerprint")
    plain = [each.split(":") for each in pins.split() if not each.startswith("-")]
    written = [
        ":".join([role, *(digits[at : at + 2] for at in range(0, 64, 2))]).upper()
        for role, digits in plain
    ]
    pqsec(line, *(f"--ca-fingerprint={each}" for each in written)).done()
