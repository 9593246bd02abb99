"""What is said after a revocation: who still accepts, until when, and commands that are pasted."""

import shlex
import subprocess
import sys

import pytest
import yaml

from pqsec_pki.enrolment.credential_store import CredentialStore
from tests.cli.conftest import clean_environment

FILE = {
    "name": "Lab",
    "profile": "classical",
    "roles": {"robot": {"publish": ["rt$name/pose"]}, "desk": {"publish": ["rt/estop"]}},
    "groups": {"hall1": ["/r1", "/r2"]},
    "participants": [{"name": "/r{1..3}", "role": "robot"}, {"name": "/desk", "role": "desk"}],
}


@pytest.fixture
def fleet(pqsec, tmp_path):
    """A fleet of a domain file, with its keys here."""
    (tmp_path / "domain.yaml").write_text(yaml.safe_dump(FILE))
    pqsec("-k k apply --yes --no-passphrase").done()
    return tmp_path


def paste(command, folder):
    """Run a command as it was printed, in a shell."""
    function = f'pqsec() {{ "{sys.executable}" -m pqsec_pki "$@"; }}\n'
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", function + command],
        cwd=folder, env=clean_environment(), capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_every_revocation_says_who_still_accepts_and_until_when(pqsec, fleet):
    """The first one told a ROS 2 user to do nothing, and the second one said nothing."""
    first = pqsec("-k k revoke /desk --reason keyCompromise --yes").done()
    assert "3 of 3 robots do not have list 1 yet (3 without a receipt: not known)" in first.out
    assert "/r1 (no receipt), /r2 (no receipt), /r3 (no receipt)" in first.out
    assert "by group: @hall1: 2, in none: 1" in first.out
    assert "they accept /desk (publish rt/estop); at the latest until " in first.out
    assert "(ROS 2 too): pqsec -k k ca crl --show --force -o crl.pem" in first.out
    second = pqsec("-k k revoke /r3 --yes").done()
    assert "2 of 2 robots do not have list 2 yet" in second.out
    assert "/desk (publish rt/estop), /r3 (publish rt/r3/pose)" in second.out
    value = pqsec("-k k revoke /r2 --yes --json").done().json["delivery"]
    assert (value["number"], value["robots"], value["without_receipt"]) == (3, 1, 1)
    assert [each["name"] for each in value["accepted"]] == ["/desk", "/r3", "/r2"]


@pytest.mark.parametrize(
    "command", ["ca crl", "renew /r1", "permit /r1 --remove --publish {} --yes"]
)
def test_each_command_after_a_theft_ends_by_saying_it(pqsec, fleet, command):
    pqsec("-k k revoke /desk --yes").done()
    line = command.format("rt/r1/pose")
    said = pqsec(f"-k k {line}").done().out
    assert "3 of 3 robots do not have list " in said
    assert "they accept /desk (publish rt/estop)" in said
    again = line.replace("/pose", "/other") if "permit" in line else line
    again = again.replace("--remove", "--add")
    if "permit" in line:
        pqsec(f"-k k {again}").done()
        again = again.replace("--add", "--remove")
    delivery = pqsec(f"-k k {again} --json").done().json["delivery"]
    assert [each["name"] for each in delivery["late"]] == ["/r1", "/r2", "/r3"]


def test_status_check_and_metrics_say_it_until_the_robots_have_the_list(pqsec, fleet):
    pqsec("-k k revoke /desk /r2 /r3 --yes").done()

    def said():
        status = pqsec("-k k status --json --prometheus m.prom").done().json["delivery"]
        rules = pqsec("-k k check --json").json["findings"]
        found = {each["rule"] for each in rules if each["rule"] in {"PQS351", "PQS352"}}
        late = [each["name"] for each in status["late"]]
        text = (fleet / "m.prom").read_text()
        return late, found, 'list="has"} 1' in text, "until_seconds" in text

    assert said() == (["/r1"], {"PQS351"}, False, True)
    assert "1 of 1 robots do not have list 1 yet" in pqsec("-k k status").done().out
    pqsec("-k k bundle /r1 --plain-key -o r1.bundle").done()
    pqsec("install r1.bundle --dir robot --trust-first").done()
    assert said()[0] == ["/r1"]
    pqsec("-k k receipt import", CredentialStore(fleet / "robot").receipt).done()
    assert said() == ([], set(), True, True)
    assert "do not have list" not in pqsec("-k k status").done().out
    pqsec("-k k ca crl").done()
    assert said()[0] == ["/r1"]  # list 2


def test_the_printed_commands_bring_the_list_to_each_kind_of_robot(pqsec, fleet):
    """A robot with its own keys installs a bundle; of a copy, the file is put beside cert.pem."""
    pqsec("request /own --profile classical --dir own").done()
    pqsec("-k k issue /own --csr own/requests/own/request.csr --publish y --bundles b").done()
    pqsec("-k k export ros2 /r1 --at /opt/x/enclaves/r1 -o copy --anyway").done()
    assert not (fleet / "copy/enclaves/r1/crl.pem").exists()
    delivery = pqsec("-k k revoke /desk --yes --json").done().json["delivery"]
    for command in delivery["commands"] * 2:
        done = paste(command, fleet)
        assert done.returncode == 0, done.stderr
    current = (fleet / "k/public/identity_ca.crl.pem").read_bytes()
    assert (fleet / "crl.pem").read_bytes() == current
    pqsec("install bundles/own.bundle --dir own --trust-first").done()
    assert (fleet / "own/current/enclaves/own/crl.pem").read_bytes() == current
    pqsec("-k k export ros2 /r1 --at /opt/x/enclaves/r1 -o later --anyway").done()
    assert (fleet / "later/enclaves/r1/crl.pem").read_bytes() == current
    assert "$ROS_SECURITY_KEYSTORE/enclaves/r1/crl.pem" in (fleet / "later/ros2.sh").read_text()


def test_a_keystore_with_a_blank_in_its_path_is_quoted(pqsec, fleet):
    (fleet / "k").rename(fleet / "my k")
    pqsec("revoke /desk --yes", PQSEC_KEYSTORE="my k").done()
    [command] = pqsec("ca crl --json", PQSEC_KEYSTORE="my k").done().json["delivery"]["commands"]
    assert shlex.split(command)[:3] == ["pqsec", "-k", "my k"]
    assert paste(command, fleet).returncode == 0


# Certificates that were replaced


def test_what_was_replaced_is_shown_and_ended_alone(pqsec, fleet):
    """Three certificates were valid, and `status` showed one."""
    pqsec("-k k renew /r1").done()
    said = pqsec("-k k issue /r1 --publish rt/r1/pose --force").done()
    assert "the certificates that /r1 had before stay valid" in said.err
    [row] = pqsec("-k k status /r1 --json").done().json["participants"]
    assert len(row["superseded"]) == 2
    assert "2, until " in pqsec("-k k status /r1").done().out
    assert pqsec("-k k log /r1").done().out.count("superseded, valid until") == 2
    lines = pqsec("-k k log /r1 --json").done().json["lines"]
    assert [each["superseded"] for each in lines if each["kind"] == "participant"] == [
        True,
        True,
        False,
    ]
    assert "PQS353" in pqsec("-k k check").out
    command = said.err.partition("no other: ")[2].strip()
    done = paste(command, fleet)
    assert done.stdout.count("(superseded)") == 2
    [row] = pqsec("-k k status /r1 --json").done().json["participants"]
    assert (row["state"], row["superseded"]) == ("valid", [])
    assert "PQS353" not in pqsec("-k k check").out
    assert "nothing to revoke" in paste(command, fleet).stdout
    assert pqsec("-k k status --json").json["delivery"]["number"] == 1


def test_superseded_takes_names_and_no_files_or_serial_numbers(pqsec, fleet):
    pqsec("-k k renew /r1").done()
    pqsec("-k k revoke --superseded --certificate k/enclaves/r1/cert.pem --yes").refused(
        2, "exclude"
    )
    pqsec("-k k revoke /r9 --superseded --yes").refused(3, "no participant /r9")
    pqsec("-k k revoke 12ab --superseded --yes").refused(3, "no participant")
    pattern = pqsec("-k k revoke /** @hall1 --superseded --yes --json").done().json
    assert [each["name"] for each in pattern["revoked"]] == ["/r1"]


def test_a_robot_that_still_runs_the_earlier_certificate_is_told(pqsec, fleet):
    pqsec("-k k bundle /r1 --plain-key -o r1.bundle").done()
    pqsec("install r1.bundle --dir robot --trust-first").done()
    pqsec("-k k receipt import robot/installed.receipt").done()
    pqsec("-k k renew /r1").done()
    said = pqsec("-k k revoke /r1 --superseded --yes").done().err
    assert "by its newest receipt, each of these still runs an earlier certificate: /r1;" in said


# permit --remove


def test_a_removal_says_until_when_the_old_document_works_and_how_it_ends(pqsec, fleet):
    """It said "taken away", and the robot's owner put the old file back (sros2#275)."""
    enclave = fleet / "k/enclaves/r1"
    old = (enclave / "permissions.p7s").read_bytes()
    done = pqsec("-k k permit /r1 --remove --publish rt/r1/pose --yes").done()
    assert "the permissions that were signed before stay valid until 20" in done.out
    (enclave / "permissions.p7s").write_bytes(old)
    assert pqsec("-k k explain /r1 --publish rt/r1/pose").code == 0  # the stacks accept it
    pqsec("-k k apply --yes").done()
    value = pqsec("-k k permit /r1 --remove --publish rt/r1/pose --yes --json").done().json
    assert [each["name"] for each in value["earlier"]] == ["/r1"]
    revoke, rotate = value["commands"]
    assert paste(revoke, fleet).returncode == 0
    pqsec("-k k issue /r1b --publish z").done()
    own = (fleet / "k/enclaves/r1b/permissions.p7s").read_bytes()
    (fleet / "k/enclaves/r1b/permissions.p7s").write_bytes(old)
    assert pqsec("-k k verify-handshake /r1b /r2").code == 1
    assert pqsec("-k k verify-handshake /r1 /r2").code == 1
    (fleet / "k/enclaves/r1b/permissions.p7s").write_bytes(own)
    done = paste(f"{rotate} --no-passphrase", fleet)
    assert done.returncode == 0, done.stderr
    (fleet / "k/enclaves/r2/permissions.p7s").write_bytes(old)
    assert pqsec("-k k verify-handshake /r2 /r3").code == 1


def test_what_adds_rights_says_nothing_of_older_documents(pqsec, fleet):
    done = pqsec("-k k permit /r1 --publish more --yes").done()
    assert "signed before" not in done.out


def test_who_has_an_earlier_certificate_has_its_document_too(pqsec, fleet):
    """A renewal for a shorter time does not shorten what was signed for the certificate before."""
    end = pqsec("-k k status /r1 --json").done().json["participants"][0]["not_after"]
    pqsec("-k k renew /r1 --validity 9d").done()
    done = pqsec("-k k permit /r1 --remove --publish rt/r1/pose --yes --json").done().json
    assert done["earlier"][0]["until"][:10] == end[:10]


# The nightly apply


def test_the_nightly_apply_goes_on_after_a_revocation(pqsec, fleet):
    """It exited with 1 every night, until somebody edited the file."""
    pqsec("-k k revoke /r2 --reason keyCompromise --yes").done()
    for line in ("apply --yes", "apply --check", "plan", "apply --yes --bundles out"):
        said = pqsec(f"-k k {line}").done()
        assert "revoked, and still in the file: /r2; /r2: remove it from the file; or" in said.err
    value = pqsec("-k k plan --json").done().json
    assert value["in_order"] is True
    assert [each["name"] for each in value["revoked"]] == ["/r2"]
    edited = FILE | {"roles": {**FILE["roles"], "robot": {"publish": ["rt$name/place"]}}}
    (fleet / "domain.yaml").write_text(yaml.safe_dump(edited))
    assert pqsec("-k k apply --check").code == 1
    done = pqsec("-k k apply --yes --json").done().json
    assert [each["name"] for each in done["steps"]] == ["/r1", "/r3"]


def test_a_revoked_participant_comes_back_by_the_command_that_apply_prints(pqsec, fleet):
    pqsec("-k k revoke /r2 --reason keyCompromise --yes").done()
    way_back = pqsec("-k k plan --json").done().json["revoked"][0]["way_back"]
    command = next(each for each in way_back.split("`") if each.startswith("pqsec"))
    assert paste(f"export PQSEC_KEYSTORE=k; {command}", fleet).returncode == 0
    said = pqsec("-k k apply --yes").done()
    assert "revoked" not in said.err
    assert pqsec("-k k verify-handshake /r2 /r1").code == 0


def test_what_is_blocked_is_still_an_error_beside_who_was_revoked(pqsec, fleet):
    pqsec("-k k revoke /r2 --yes").done()
    more = [*FILE["participants"], {"name": "/x", "role": "robot", "request": "x.csr"}]
    (fleet / "domain.yaml").write_text(yaml.safe_dump({**FILE, "participants": more}))
    assert pqsec("-k k apply --yes").code == 1
