"""pqsec demo, as a newcomer runs it: a whole domain, made and proved in one command."""

import json
import os
import subprocess
import sys
from base64 import b64decode

import pytest

from pqsec_pki.algorithms import PROFILES

NAMES = [profile.name for profile in PROFILES]


@pytest.fixture
def run(tmp_path):
    """run("demo", ..., VARIABLE=...) runs pqsec in the test's folder: exit code, stdout, stderr."""

    def pqsec(*arguments, **environment):
        done = subprocess.run(
            [sys.executable, "-m", "pqsec_pki", *arguments],
            cwd=tmp_path,
            env=dict(os.environ) | environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        return done.returncode, done.stdout, done.stderr

    return pqsec


def secrets(folder):
    """Every private key's PEM lines, and its bytes in hex."""
    for path in folder.rglob("*key.pem"):
        lines = path.read_text().splitlines()[1:-1]
        yield from lines
        yield b64decode("".join(lines)).hex()[-64:]


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("profile", NAMES)
def test_the_demo_makes_a_domain_and_proves_it(run, tmp_path, profile):
    code, out, err = run("demo", "--profile", profile)
    assert (code, err) == (0, "")
    assert out.startswith(f"Created a secured domain in pqsec-demo, profile {profile}: ")
    assert "FAIL" not in out
    assert out.count("\nok    ") == 16
    enclaves = tmp_path / "pqsec-demo/enclaves"
    for name in ("talker", "listener"):
        assert (enclaves / name / "permissions.p7s").is_file()
    code, out, err = run("-k", "pqsec-demo", "verify-handshake", "/talker", "/listener")
    assert (code, err) == (0, "")


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("profile", NAMES)
def test_no_private_key_is_shown(run, tmp_path, profile):
    shown = ""
    for option in ((), ("--json",)):
        folder = f"demo{len(option)}"
        code, out, err = run("demo", folder, "--profile", profile, *option)
        assert code == 0
        shown += out + err
    hidden = list(secrets(tmp_path))
    assert len(hidden) >= 16
    assert [secret for secret in hidden if secret in shown] == []


def test_the_demo_is_transition_unless_asked_and_tells_json(run):
    code, out, _ = run("demo", "--json")
    told = json.loads(out)
    assert code == 0
    assert told["profile"] == "transition"
    assert told["keystore"] == "pqsec-demo"
    assert told["handshake"]["ok"] is True


@pytest.mark.slow
def test_a_second_demo_is_refused_and_changes_nothing(run, tmp_path):
    assert run("demo")[0] == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    code, out, err = run("demo")
    assert (code, out) == (3, "")
    assert err == (
        "pqsec: error: pqsec-demo already has pqsec.json, private, public, enclaves\n"
        "pqsec: hint: `pqsec demo pqsec-demo-2` creates another domain, and leaves this one as it"
        " is\n"
    )
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert run("demo", "pqsec-demo-2")[0] == 0
    assert "`pqsec demo pqsec-demo-3`" in run("demo")[2]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    ("arguments", "folder"),
    [
        (("demo",), "pqsec-demo"),
        (("-k", "mine", "demo"), "mine"),
        (("demo", "-k", "mine"), "mine"),
        (("demo", "folder"), "folder"),
        (("-k", "mine", "demo", "folder"), "folder"),
    ],
)
def test_the_demo_is_in_the_folder_named_or_the_keystore_named_or_its_own(
    run, tmp_path, arguments, folder
):
    """A variable names a keystore that is in use: no place for a demo."""
    code, out, _ = run(*arguments, "--json", PQSEC_KEYSTORE="variable")
    assert code == 0
    assert json.loads(out)["keystore"] == folder
    assert [path.name for path in tmp_path.iterdir()] == [folder]


@pytest.mark.slow
def test_the_steps_that_the_demo_prints_run_as_they_are_but_for_the_passphrase(run):
    _, out, _ = run("demo", "--profile", "pq")
    steps = [line.split()[1:] for line in out.splitlines() if line.startswith("  pqsec -k")]
    assert len(steps) == 4
    for step in steps:
        extra = ["--no-passphrase"] if "init" in step else []
        assert run(*step, *extra)[0] == 0
