"""Commands with a wrong clock, which faketime makes."""

import json
import shutil
import subprocess
import sys

import pytest

from tests.cli.conftest import clean_environment

FAKETIME = "faketime"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not shutil.which(FAKETIME), reason="faketime is not there: apt-get install faketime"
    ),
]


@pytest.fixture
def at(tmp_path):
    """at("+30d", "-k k status") runs the command in the test's folder, with that clock."""

    def run(clock, line, code=0):
        done = subprocess.run(
            [FAKETIME, "-f", clock, sys.executable, "-m", "pqsec_pki", *line.split()],
            cwd=tmp_path,
            env=clean_environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code, (done.stdout, done.stderr)
        return done

    return run


@pytest.fixture
def k(keystore):
    return keystore("classical")


def words(done):
    return " ".join(done.stderr.split())


@pytest.mark.parametrize(
    "line",
    [
        "issue /new --publish x",
        "permit /talker --publish x --yes",
        "revoke /talker --yes",
        "sign-governance k/enclaves/governance.xml -o k/enclaves/governance.p7s --force",
        "ca rotate --apply --yes --no-passphrase",
    ],
)
def test_a_clock_behind_the_ledger_is_an_error_that_names_the_option(at, k, line):
    before = {path: path.read_bytes() for path in k.rglob("*") if path.is_file()}
    done = at("-3d", f"-k k {line}", code=3)
    assert "pqsec: error: the clock says" in done.stderr
    assert "--accept-clock" in words(done)
    assert {path: path.read_bytes() for path in k.rglob("*") if path.is_file()} == before
    at("-3d", f"-k k {line} --accept-clock")


def test_what_was_made_ahead_is_seen_and_made_again(at, k):
    at("+450d", "-k k renew --all")
    done = at("+0", "-k k needs-renewal")
    assert "/talker  not-yet-valid" in done.stdout
    found = json.loads(at("+0", "-k k status --json").stdout)
    assert {each["state"] for each in found["participants"]} == {"not-yet-valid"}
    assert found["future"].keys() == {"the ledger's newest line"}
    assert "the clock is behind, or was ahead then" in words(at("+0", "-k k status"))
    assert "PQS112" in at("+0", "check k", code=1).stdout
    at("+0", "-k k renew --due", code=3)
    at("+0", "-k k renew --due --accept-clock")
    at("+0", "-k k needs-renewal", code=1)


def test_a_robot_takes_what_follows_a_governance_of_the_future(at, k, tmp_path):
    sign = "-k k sign-governance k/enclaves/governance.xml -o k/enclaves/governance.p7s --force"
    at("+30d", sign)
    at("+0", "-k k bundle /talker --plain-key -o 1")
    done = at("+0", "install 1 --dir rob --trust-first")
    assert "signed" in done.stderr
    assert "in the future" in words(done)
    assert "PQS348" in at("+0", "check rob").stdout
    at("+0", f"{sign} --accept-clock")
    at("+0", "-k k revoke /listener --yes")
    at("+0", "-k k bundle /talker --plain-key -o 2")
    older = at("-20000d", "install 1 --dir rob")
    assert "was already installed" in older.stdout
    assert at("-20000d", "install 2 --dir rob").stdout.startswith("/talker  installed")
    for clock in ("-20000d", "+0", "+30d"):
        assert "is older than one installed before" in words(at(clock, "install 1 --dir rob", 1))
    assert "PQS348" not in at("+0", "check rob/current/enclaves").stdout
