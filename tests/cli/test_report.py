"""pqsec report: the file that it writes, and its exit codes."""

import json
import os
import pty
import shutil
import subprocess
import sys

import pytest

from tests.cli.conftest import NAMES
from tests.unit.test_migration import DOMAIN

CHROMIUM = shutil.which("chromium")


def test_a_page_is_not_written_to_a_terminal(keystore, tmp_path):
    keystore("classical")
    screen, terminal = pty.openpty()
    line = [sys.executable, "-m", "pqsec_pki", "-k", tmp_path / "k", "report"]
    done = subprocess.run(line, stdout=terminal, stderr=subprocess.PIPE, check=False)
    os.close(terminal)
    os.close(screen)
    assert done.returncode == 2
    assert b"-o report.html" in done.stderr


def test_the_page_is_written_for_its_owner_alone_and_never_over_another_file(
    pqsec, keystore, tmp_path
):
    keystore("transition")
    pqsec("-k k report -o page.html").done()
    page = tmp_path / "page.html"
    assert page.stat().st_mode & 0o777 == 0o600
    assert page.read_text().startswith("<!DOCTYPE html>")
    assert "Security report of <bdi>k</bdi>" in page.read_text()
    assert "pqsec -k k report -o page.html" in page.read_text()
    before = page.read_bytes()
    pqsec("-k k report -o page.html").refused(3, "page.html exists", hint="--force")
    assert page.read_bytes() == before
    pqsec("-k k report --force -o page.html").done()
    assert page.read_bytes() != before


@pytest.mark.parametrize("profile", NAMES)
def test_every_profile_has_a_complete_report(pqsec, keystore, profile):
    keystore(profile)
    found = json.loads(pqsec("-k k report --format json").done().out)
    assert found["complete"]
    assert found["profile"] == profile
    assert [each["name"] for each in found["participants"]] == ["/listener", "/talker"]
    assert found["evidence"]["audit"] == []


def test_json_is_the_same_with_the_common_option(pqsec, keystore):
    keystore("classical")
    one, other = (
        json.loads(pqsec(f"-k k report {how}").done().out) for how in ("--json", "--format json")
    )
    different = {key for key in one if one[key] != other[key]}
    assert different <= {"at", "command"}


def test_the_steps_to_another_profile_are_those_of_migrate_plan(pqsec, keystore, tmp_path):
    keystore("classical")
    told = "--stack cyclonedds --json"
    plan = pqsec(f"-k k migrate plan --to cnsa2 {told}").done().json
    found = pqsec(f"-k k report --migrate-to cnsa2 {told}").done().json["migration"]
    assert found == plan
    (tmp_path / "names.txt").write_text("/talker\n/listener\n")
    (tmp_path / "domain.yaml").write_text(DOMAIN)
    line = "-k k report --migrate-to transition --domain-file domain.yaml --json"
    [step] = pqsec(line).done().json["migration"]["steps"]
    assert [each["stack"] for each in step["stacks"]] == ["Cyclone DDS", "Fast DDS 3.1"]
    pqsec("-k k report --stack cyclonedds").refused(2, "for a migration", hint="--migrate-to")
    pqsec("-k k report --domain-file domain.yaml").refused(2, "for a migration")
    pqsec("-k k report --migrate-to pq --domain-file none.yaml").refused(3, "none.yaml")


def test_changes_since_an_earlier_report(pqsec, keystore):
    keystore("classical")
    pqsec("-k k report --format json -o old.json").done()
    pqsec("-k k permit /talker --add --publish rt/new --yes").done()
    pqsec("-k k revoke /listener --yes").done()
    page = pqsec("-k k report --compare old.json").done().out
    assert "/talker may publish rt/new on 0" in page
    assert "Rights removed" in page
    changes = json.loads(pqsec("-k k report --compare old.json --json").done().out)["changes"]
    assert [each["topic"] for each in changes["granted"]] == ["rt/new"]
    assert {each["participant"] for each in changes["removed"]} == {"/listener"}
    csv = pqsec("-k k report --compare old.json --format csv").done().out
    assert "granted: publish" in csv
    pqsec("-k k report --compare k/pqsec.json").refused(3, "k/pqsec.json: not a report")


def test_a_damaged_part_is_told_with_exit_3(pqsec, keystore):
    (keystore("classical") / "enclaves/governance.p7s").write_text("damaged")
    said = pqsec("-k k report -o page.html")
    assert said.code == 3
    assert "note: incomplete: Who may command what: k/enclaves/governance.p7s" in said.err
    pqsec("-k nowhere report").refused(3, "nowhere does not exist")


@pytest.mark.parametrize("profile", ["classical", "transition", "cnsa2"])
def test_a_signed_report_is_verified_with_the_signatures_of_its_profile(
    pqsec, keystore, tmp_path, profile
):
    keystore(profile)
    pqsec("-k k report --sign -o june.html").done()
    pqsec("-k k report --signer k/public/permissions_ca.cert.pem k/private/permissions_ca.key.pem"
          " --format csv -o june.csv").done()  # fmt: skip
    assert (tmp_path / "june.html").read_text().startswith("<!DOCTYPE html>")
    assert (tmp_path / "june.html.p7s").stat().st_mode & 0o777 == 0o600
    found = json.loads(pqsec("-k k verify june.html.p7s --json").done().out)
    assert (found["kind"], found["file"]) == ("report", "june.html")
    assert len(found["signatures"]) == (2 if profile == "transition" else 1)
    pqsec("verify june.csv.p7s --ca k/public/permissions_ca.cert.pem").done()
    if profile == "transition":  # the certificate and key of one CA make one signature
        pqsec("-k k verify june.csv.p7s").refused(1, "no post-quantum signature")


def test_a_changed_report_and_a_signature_by_another_ca_are_refused(pqsec, keystore, tmp_path):
    keystore("classical")
    keystore("classical", "other", "another")
    pqsec("-k k report --sign -o june.html").done()
    pqsec("-k other report --sign -o july.html").done()
    page = tmp_path / "june.html"
    pqsec("-k other verify june.html.p7s").refused(1, "not signed by")
    pqsec("-k k report --sign -o june.html").refused(3, "june.html exists")
    page.rename(tmp_path / "kept.html")
    pqsec("-k k report --sign -o june.html").refused(3, "june.html.p7s exists")
    pqsec("-k k verify june.html.p7s").refused(3, "june.html: no such file")
    page.write_bytes((tmp_path / "kept.html").read_bytes().replace(b"talker", b"walker", 1))
    pqsec("-k k verify june.html.p7s").refused(1, "june.html was changed after signing")
    pqsec("-k k verify june.html").refused(1, hint="`pqsec verify june.html.p7s`")
    (tmp_path / "july.html").rename(page)
    (tmp_path / "july.html.p7s").rename(tmp_path / "june.html.p7s")
    pqsec("-k other verify june.html.p7s").refused(1, "the signature of july.html")


def test_a_signature_is_not_taken_for_that_of_another_report(pqsec, keystore, tmp_path):
    keystore("classical")
    pqsec("-k k report --sign -o may.html").done()
    (tmp_path / "june.html").write_text("forged")
    (tmp_path / "june.html.p7s").write_bytes((tmp_path / "may.html.p7s").read_bytes())
    pqsec("-k k verify june.html.p7s").refused(1, "june.html.p7s is the signature of may.html")
    pqsec("-k k verify may.html.p7s").done()


def test_a_report_is_not_signed_by_what_verify_would_refuse(pqsec, keystore, locked, tmp_path):
    own = keystore("classical", "own")
    key = "own/private/permissions_ca.key.pem"
    pqsec("-k own report --sign").refused(2, "beside the report", hint="-o FILE")
    line = "-k own report -o june.html --signer"
    pqsec(f"{line} own/public/identity_ca.cert.pem {key}").refused(3, f"{key} is not the private")
    talker = own / "enclaves/talker"
    pqsec(f"{line} {talker}/cert.pem {talker}/key.pem").refused(1, "not marked as a CA", problems=3)
    pqsec("-k k report --sign -o june.html --passphrase-file wrong").refused(3, "passphrase")
    assert not list(tmp_path.glob("june*"))
    pqsec("-k k report --sign -o june.html --passphrase-file right").done()
    pqsec("-k k verify june.html.p7s").done()


@pytest.mark.interop
def test_openssl_and_sha512sum_verify_a_signed_report(pqsec, keystore, tmp_path):
    keystore("classical")
    pqsec("-k k report --sign -o june.html").done()
    line = (
        "openssl smime -verify -text -CAfile k/public/permissions_ca.cert.pem -in june.html.p7s"
        r" | tr -d '\r' | sha512sum -c"
    )
    done = subprocess.run(
        ["bash", "-c", line], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "june.html: OK\n"


@pytest.mark.interop
@pytest.mark.skipif(not CHROMIUM, reason="in .ci/long: chromium is not installed here")
def test_chromium_runs_the_page_under_its_policy(pqsec, keystore, tmp_path):
    keystore("transition")
    pqsec("-k k report -o page.html").done()
    browser = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    browser += ["--v=0", f"--user-data-dir={tmp_path / 'browser'}"]
    page = (tmp_path / "page.html").as_uri()
    done = subprocess.run(
        [*browser, "--dump-dom", page], capture_output=True, text=True, timeout=120, check=True
    )
    # The script ran: it shows the tools, which are hidden without it.
    assert '<form id="tools" role="search">' in done.stdout
    assert "CONSOLE" not in done.stderr
    pdf = tmp_path / "page.pdf"
    subprocess.run(
        [*browser, f"--print-to-pdf={pdf}", page], capture_output=True, timeout=120, check=True
    )
    assert pdf.read_bytes().startswith(b"%PDF")
