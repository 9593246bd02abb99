"""Commands refuse a place that another user could change; commands that only read do not."""

import json
import os
import shlex
import shutil
import subprocess
import sys

import pytest

from tests.cli.conftest import snapshot
from tests.running import clean_environment

NOBODY = 65534
DOMAIN = """
name: Lab
profile: classical
roles:
  robot: {publish: [rt$name/pose]}
participants:
  - {name: /r1, role: robot}
  - {csv: robots.csv}
"""


@pytest.fixture
def place(tmp_path):
    """A folder of the caller, in which a test works; the folder above can be opened."""
    made = tmp_path / "team/work"
    made.mkdir(parents=True)
    for each in (made.parent, made):
        each.chmod(0o755)
    return made


@pytest.fixture
def pqsec(run_in, place):
    return lambda line, *more, **environment: run_in(place, line, *more, **environment)


@pytest.fixture
def keystore(pqsec, place):
    (place / "domain.yaml").write_text(DOMAIN)
    (place / "robots.csv").write_text("name,role\n/r2,robot\n")
    pqsec("-k k apply --yes --no-passphrase").done()
    return place / "k"


WORDS = ("anybody may write there",)
CHANGES = {
    "issue": "-k k issue /new --publish rt/a",
    "permit": "-k k permit /r1 --publish rt/c --yes",
    "renew": "-k k renew /r1",
    "revoke": "-k k revoke /r1 --yes",
    "crl": "-k k ca crl",
    "apply": "-k k apply --yes --no-passphrase",
    "init": "-k new ca init --no-passphrase",
    "serve --init": "-k k serve --init https://a.example:1",
}
READING = ["status", "log", "ca show", "verify-handshake /r1 /r2", "who-may k --topic rt/r1/pose"]


@pytest.mark.parametrize("command", [each for each in CHANGES if each != "serve --init"])
def test_a_folder_above_the_keystore_that_others_can_change_stops_every_change(
    pqsec, keystore, place, command
):
    place.parent.chmod(0o777)
    before = snapshot(place)
    (place / "domain.yaml").write_text(
        DOMAIN.replace("  - {csv", "  - {name: /r3, role: robot}\n  - {csv")
    )
    done = pqsec(CHANGES[command])
    assert done.code == 3, done
    assert f"{place.parent}: anybody may write there" in done.err
    assert f"chmod go-w {place.parent}" in done.err
    (place / "domain.yaml").write_text(DOMAIN)
    assert snapshot(place) == before


@pytest.mark.parametrize(
    "folder",
    ["public", "enclaves", "private", "enclaves/fleet", "enclaves/r1", "private/generations/1"],
)
def test_every_folder_of_the_keystore_is_looked_at(pqsec, keystore, folder):
    """Only the root, private/ and the ledger were: a web server's group put an old list back."""
    if "generations" in folder:
        pqsec("-k k ca rotate --apply --yes --no-passphrase").done()
    pqsec("-k k issue /fleet/r9 --publish rt/a").done()
    (keystore / folder).chmod(0o777)
    for line in ("permit /r1 --publish rt/z --yes", "issue /fleet/r9 --force --publish rt/b"):
        if folder == "enclaves/fleet" and line.startswith("permit"):
            continue  # it does not go there
        if folder == "enclaves/r1" and line.startswith("issue"):
            continue
        pqsec(f"-k k {line}").refused(3, f"k/{folder}: {WORDS[0]}", hint=f"k/{folder}")


def test_an_open_folder_of_a_participant_that_is_replaced_is_closed(pqsec, keystore):
    (keystore / "enclaves/r1").chmod(0o777)
    pqsec("-k k issue /r1 --force --publish rt/a").done()
    assert (keystore / "enclaves/r1").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(
    "file", ["public/identity_ca.cert.pem", "enclaves/governance.p7s", "pqsec.json", "groups.json"]
)
def test_every_file_that_all_commands_use_is_looked_at(pqsec, keystore, file):
    (keystore / file).touch()
    (keystore / file).chmod(0o666)
    pqsec("-k k issue /new --publish rt/a").refused(3, f"{keystore / file}: {WORDS[0]}")


def test_a_web_servers_group_cannot_put_an_old_list_back(pqsec, keystore):
    if os.geteuid() != 0:
        pytest.skip("another group can be tried by root only")
    os.chown(keystore / "public", -1, NOBODY)
    (keystore / "public").chmod(0o775)
    pqsec("-k k issue /new --publish rt/a").refused(3, f"group {group_name()} may write there")


def group_name():
    return subprocess.run(
        ["id", "-gn", "nobody"], check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.mark.parametrize("line", READING)
def test_commands_that_only_read_answer_all_the_same(pqsec, keystore, place, line):
    """Others may read a keystore, and what they read is verified or shown, and never obeyed."""
    place.parent.chmod(0o777)
    (keystore / "public").chmod(0o777)
    assert pqsec(f"-k k {line}").code in {0, 1}


@pytest.mark.parametrize("file", ["domain.yaml", "robots.csv"])
def test_a_domain_file_that_anybody_may_write_is_not_applied(pqsec, keystore, place, file):
    (place / file).chmod(0o666)
    pqsec("-k k apply --yes").refused(3, f"{file}: {WORDS[0]}", hint=f"chmod go-w {place / file}")
    pqsec("-k k apply --check").done()
    pqsec("-k k plan").done()


def test_a_request_that_anybody_may_replace_gets_no_certificate(pqsec, keystore, place):
    (place / "requests").mkdir()
    pqsec("request /r3 --profile classical --dir robot --csr requests/r3.csr").done()
    text = DOMAIN.replace("  - {csv", "  - {name: /r3, role: robot, request: requests/}\n  - {csv")
    (place / "domain.yaml").write_text(text)
    (place / "requests").chmod(0o777)
    refused = pqsec("-k k apply --yes")
    refused.refused(3, f"{place / 'requests'}: {WORDS[0]}", hint="chmod go-w")
    (place / "requests").chmod(0o755)
    pqsec("-k k apply --yes").done()


def test_a_passphrase_that_anybody_may_choose_is_not_used(pqsec, place):
    (place / "passphrase").write_text("correct horse battery staple")
    (place / "passphrase").chmod(0o622)
    made = pqsec("-k k ca init --passphrase-file passphrase")
    assert made.code == 3
    assert "passphrase: anybody may write there; anyone who may write there decides" in made.err
    assert not (place / "k").exists()


def test_a_passphrase_of_a_pipe_is_used(place):
    program = f"{shlex.quote(sys.executable)} -m pqsec_pki"
    command = f"{program} -k k ca init --passphrase-file <(echo correct horse battery staple)"
    done = subprocess.run(
        ["bash", "-c", command],
        check=False,
        cwd=place,
        env=clean_environment(),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_a_policy_that_anybody_may_write_is_not_signed(pqsec, keystore, place):
    policy = place / "policy.yaml"
    policy.write_text("grants:\n  - {name: /p1, publish: [rt/a]}\n")
    pqsec("-k k issue --policy policy.yaml").done()
    policy.chmod(0o666)
    pqsec("-k k issue --policy policy.yaml --force").refused(3, f"policy.yaml: {WORDS[0]}")
    pqsec("-k k permit /p1 --policy policy.yaml --yes").refused(3, f"policy.yaml: {WORDS[0]}")


def test_a_document_that_anybody_may_write_is_not_signed(pqsec, keystore, place):
    file = place / "governance.xml"
    shutil.copy(keystore / "enclaves/governance.xml", file)
    file.chmod(0o666)
    pqsec("-k k sign-governance governance.xml").refused(3, f"governance.xml: {WORDS[0]}")


def test_a_robots_folder_below_an_open_one_is_refused(pqsec, keystore, place):
    pqsec("-k k bundle /r1 --plain-key -o b").done()
    (place / "shared/robot").mkdir(parents=True)
    (place / "shared").chmod(0o777)
    pins = pqsec("-k k ca show --pins").out
    pqsec(f"install b --dir shared/robot {pins}").refused(
        3, f"{place / 'shared'}: {WORDS[0]}", hint="or choose another --dir"
    )


@pytest.mark.parametrize("file", ["trust.json", "installed", "requests"])
def test_what_a_robot_trusts_is_looked_at(pqsec, keystore, place, file):
    pqsec("-k k bundle /r1 --plain-key -o b").done()
    pins = pqsec("-k k ca show --pins").out
    pqsec(f"install b --dir robot {pins}").done()
    (place / "robot/requests").mkdir(exist_ok=True)
    (place / "robot" / file).chmod(0o777)
    pqsec("install b --dir robot").refused(3, f"{place / 'robot' / file}: {WORDS[0]}")


def test_a_plugin_below_a_folder_that_others_can_change_is_refused_and_told(pqsec, requires, place):
    """Another user moved the folder away and put a library of their own in its place."""
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    (place / "shared").mkdir()
    (place / "shared").chmod(0o777)
    where, words = place / "shared", f"{place / 'shared'}: {WORDS[0]}"
    pqsec("plugin install --dir shared/pqsec").refused(3, words, hint=f"chmod go-w {where}")
    assert list(where.iterdir()) == []
    where.chmod(0o755)
    pqsec("plugin install --dir shared/pqsec").done()
    assert pqsec("plugin status --dir shared/pqsec").code == 0
    where.chmod(0o777)
    found = pqsec("plugin status --dir shared/pqsec")
    assert (found.code, words in found.out, f"chmod go-w {where}" in found.out) == (1, True, True)
    said = json.loads(pqsec("plugin status --dir shared/pqsec --json").out)
    assert [each["ok"] for each in said["installed"]] == [False]
    pqsec("-k k ca init --no-passphrase --profile classical")
    pqsec("-k k issue /r1 --publish rt/a").done()
    pqsec("-k k export cyclonedds /r1 --plugin --plugins shared/pqsec -o out").refused(3, words)
    assert not (place / "out").exists()


def test_an_enrolment_token_that_anybody_may_write_is_not_trusted(pqsec, place):
    (place / "token").write_text("{}")
    (place / "token").chmod(0o602)
    done = pqsec("enrol --token-file token --dir r")
    assert (done.code, f"token: {WORDS[0]}" in done.err) == (3, True)
