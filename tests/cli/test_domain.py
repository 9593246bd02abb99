"""plan and apply, as their users run them."""

import os
import pty
import shutil
import subprocess
import sys
from contextlib import suppress

import pytest
import yaml

from tests.cli.conftest import clean_environment, snapshot

FILE = """
name: Lab
profile: classical
roles:
  robot: {publish: [rt$name/pose]}
participants:
  - {name: "/r{1..3}", role: robot}
"""


@pytest.fixture
def domain(tmp_path):
    file = tmp_path / "domain.yaml"
    file.write_text(FILE)
    return file


@pytest.fixture
def change(domain):
    def changed(old, new):
        assert old in domain.read_text()
        domain.write_text(domain.read_text().replace(old, new))

    return changed


@pytest.fixture
def applied(pqsec, domain):
    pqsec("-k k apply --yes --no-passphrase").done()
    return domain


def test_check_is_for_ci(pqsec, applied, change, tmp_path):
    assert pqsec("-k k apply --check --json").done().json["in_order"] is True
    change("pose", "place")
    before = snapshot(tmp_path / "k")
    found = pqsec("-k k apply --check --json")
    assert found.code == 1
    assert found.json["steps"] == [
        {"action": "sign-permissions", "name": f"/r{n}", "why": "its role (robot) was changed"}
        for n in (1, 2, 3)
    ]
    assert snapshot(tmp_path / "k") == before


def test_encrypted_keys_are_unlocked_where_there_is_something_to_do(pqsec, locked, domain):
    domain.write_text(FILE.replace("name: Lab", ""))
    pqsec("-k k apply --yes --passphrase-file wrong").refused(3, "passphrase")
    pqsec("-k k apply --yes --passphrase-file right").done()
    assert pqsec("-k k apply").done().out.startswith("no changes")


def test_prune_revokes_and_says_so(pqsec, applied, change):
    change("1..3", "1..2")
    told = pqsec("-k k plan").done()
    assert "note: not in domain.yaml: /r3; --prune revokes" in told.err
    assert pqsec("-k k plan --prune").code == 1
    done = pqsec("-k k apply --prune --yes --json").done()
    assert done.json["done"] is True
    assert [(each["action"], each["name"]) for each in done.json["steps"]] == [("revoke", "/r3")]
    assert done.json["delivery"]["without_receipt"] == 2
    pqsec("-k k plan --prune").done()
    assert pqsec("-k k verify-handshake /r1 /r3").code == 1


def test_who_has_its_key_elsewhere_is_given_no_other(pqsec, applied, tmp_path):
    pqsec("request /r4 --profile classical --dir robot").done()
    [request] = (tmp_path / "robot").rglob("*.csr")
    pqsec("-k k issue /r4 --publish x --csr", request).done()
    applied.write_text(FILE.replace("1..3", "1..4"))
    assert (
        "sign permissions for  /r4  (its permissions were not made from the file)"
        in pqsec("-k k plan").out
    )
    pqsec("-k k apply --yes").done()
    pqsec("-k k renew /r4").done()
    assert not (tmp_path / "k/enclaves/r4/key.pem").exists()
    shutil.rmtree(tmp_path / "k/enclaves/r4")
    told = pqsec("-k k plan")
    assert told.code == 1
    assert "blocked: /r4 has its key elsewhere, and its certificate is missing; " in told.out


def test_many_names_are_counted_and_json_has_them_all(pqsec, domain, change):
    change("1..3", "01..30")
    assert (
        "issue                /r01, /r02, /r03, /r04 and 26 more  (new)" in pqsec("-k k plan").out
    )
    steps = pqsec("-k k plan --json").json["steps"]
    assert [step["name"] for step in steps[2:]] == [f"/r{n:02}" for n in range(1, 31)]


def test_init_writes_a_file_that_plan_takes_and_replaces_none(pqsec, tmp_path):
    pqsec("plan --init").done()
    assert yaml.safe_load((tmp_path / "domain.yaml").read_text())["name"] == "Robots"
    assert pqsec("-k k plan").code == 1
    pqsec("plan --init").refused(3, "domain.yaml exists")
    pqsec("plan --init other.yaml").done()


def test_it_asks_on_a_terminal(domain, tmp_path):
    said = on_a_terminal(tmp_path, "-k", "k", "apply", "--no-passphrase", answer=b"y\n")
    assert "issue                /r1, /r2, /r3  (new)" in said
    assert "Make these changes? [y/N]" in said
    assert (tmp_path / "k/enclaves/r3/cert.pem").exists()


def test_a_terminal_shows_what_would_be_revoked_and_asks(keystore, tmp_path):
    keystore()
    line = ("-k", "k", "revoke", "/talker")
    said = on_a_terminal(tmp_path, *line, answer=b"n\n")
    assert "revoke: /talker  " in said
    assert "Revoke these? It cannot be undone. [y/N]" in said
    assert not (tmp_path / "k/public/identity_ca.crl.pem").exists()
    on_a_terminal(tmp_path, *line, answer=b"y\n")
    assert (tmp_path / "k/public/identity_ca.crl.pem").exists()


def test_a_no_at_the_terminal_does_nothing(domain, tmp_path):
    assert "interrupted" in on_a_terminal(tmp_path, "-k", "k", "apply", answer=b"n\n")
    assert not (tmp_path / "k").exists()


def on_a_terminal(folder, *words, answer):
    """What pqsec shows on a terminal where somebody types `answer`."""
    ours, its = pty.openpty()
    command = [sys.executable, "-m", "pqsec_pki", *words]
    streams = {"stdin": its, "stdout": its, "stderr": its}
    process = subprocess.Popen(command, cwd=folder, env=clean_environment(), **streams)
    os.close(its)
    os.write(ours, answer)
    said = b""
    with suppress(OSError):  # Linux's way to say that the other side is closed
        while data := os.read(ours, 4096):
            said += data
    process.wait(timeout=300)
    os.close(ours)
    return said.decode().replace("\r\n", "\n")


# Keys on robots


@pytest.fixture
def robots(pqsec, domain, change, tmp_path):
    """/r3 makes its own key; its request is where the file says."""
    change('name: "/r{1..3}", role: robot}', 'name: "/r{1..2}", role: robot}')
    domain.write_text(domain.read_text() + "  - {name: /r3, role: robot, request: inbox/}\n")
    (tmp_path / "inbox").mkdir()

    def ask():
        pqsec("request /r3 --profile classical --dir robot --force").done()
        shutil.copyfile(tmp_path / "robot/requests/r3/request.csr", tmp_path / "inbox/r3.csr")

    return ask


def test_the_requests_of_a_robot_are_answered_from_one_file(pqsec, domain, change):
    change('name: "/r{1..3}", role: robot}', 'name: "/r{1..3}", role: robot, request: robot.csr}')
    pqsec("request /r1 /r3 --profile classical --dir robot --csr robot.csr").done()
    told = pqsec("-k k apply --yes --no-passphrase --bundles out")
    assert (told.code, "issue: 2 (/r1, /r3)" in told.out) == (1, True)
    words = (
        "/r2 its request is refused: robot.csr: no request in it is for /r2: there is one for /r1"
    )
    assert f"note: {words} and 1 more: not changed" in told.err
    pqsec("install out/r1.bundle --dir robot --trust-first").done()


def test_robots_without_requests_are_told_in_one_note(pqsec, domain, change):
    change('name: "/r{1..3}", role: robot}', 'name: "/r{1..3}", role: robot, request: inbox/}')
    told = pqsec("-k k apply --yes --no-passphrase")
    assert told.code == 1
    assert "note: each of /r1, /r2, /r3 has sent no request (new): not changed" in told.err


def test_a_robot_that_asks_is_answered_with_a_bundle_that_it_installs(pqsec, robots, tmp_path):
    told = pqsec("-k k apply --yes --no-passphrase --bundles out")
    assert told.code == 1
    assert "note: /r3 has sent no request (new): not changed" in told.err
    assert not (tmp_path / "out").exists()
    robots()
    told = pqsec("-k k apply --yes --bundles out").done()
    assert told.out.splitlines() == ["issue: 1 (/r3)", "bundles: 1"]
    assert pqsec("-k k apply --bundles out").done().out.startswith("no changes; 3 participants")
    pqsec("install out/r3.bundle --dir robot --trust-first").done()
    assert (tmp_path / "robot/current/enclaves/r3/key.pem").exists()
    (tmp_path / "out/r3.bundle").unlink()  # as if it was killed before
    told = pqsec("-k k apply --bundles out --json").done()
    assert (told.json["steps"], told.json["bundles"]) == ([], ["out/r3.bundle"])


def test_bundles_are_written_although_somebody_could_not_be_done(pqsec, robots, change, tmp_path):
    robots()
    change("publish: [rt$name/pose]", "publish: [rt$name/pose], nodes: $zone")
    change("inbox/}", "inbox/, values: {zone: /ok}}")
    change("role: robot}", "role: robot, values: {zone: '/no good'}}")
    told = pqsec("-k k apply --yes --no-passphrase --bundles out")
    assert told.code in {1, 3}
    assert (tmp_path / "out/r3.bundle").exists()


# Slips


def test_a_list_that_was_cut_short_does_not_take_back_a_fleet(pqsec, applied, change):
    change("1..3", "3..3")
    pqsec("-k k apply --prune --yes").refused(
        2, "2 participants would be revoked, and domain.yaml names 1", hint="--revoke-most"
    )
    assert pqsec("-k k plan --prune --json").json["unchanged"] == 1
    told = pqsec("-k k apply --prune --yes --revoke-most --json").done()
    assert [each["name"] for each in told.json["steps"]] == ["/r1", "/r2"]
    reasons = {each["details"].get("reason") for each in pqsec("-k k log --json").json["lines"]}
    assert reasons == {None, "cessationOfOperation"}
