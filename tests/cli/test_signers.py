"""CA keys that another process holds, by the package in examples/signer."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pqsec_pki.algorithms import SIGNATURES, private_key_pem

EXAMPLE = Path(__file__).parents[2] / "examples/signer"
LONG_ENOUGH = 600
"""Times a tenth of a second."""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The environment of a process with the package."""
    site = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--no-index", "--target", site, EXAMPLE], check=True)
    return os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(site)])}


@pytest.fixture
def run(installed, tmp_path):
    def run(line, code=0):
        done = subprocess.run(
            [sys.executable, "-m", "pqsec_pki", "-k", "k", *line.split()],
            cwd=tmp_path, env=installed, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout + done.stderr

    return run


@pytest.fixture
def holder(tmp_path):
    """holder(algorithm) starts a process that holds a new key, and gives its URI."""
    started = []

    def start(algorithm="ecdsa-p256"):
        key, place = tmp_path / f"key{len(started)}", tmp_path / f"s{len(started)}"
        key.write_bytes(private_key_pem(SIGNATURES.named(algorithm).generate()))
        command = [sys.executable, EXAMPLE / "signing_process.py", key, place]
        started.append(subprocess.Popen(command))
        for _ in range(LONG_ENOUGH):
            if place.exists():
                return f"socket:{place}"
            time.sleep(0.1)
        raise AssertionError("the process does not listen")

    yield start
    for each in started:
        each.kill()
        each.wait()


def test_a_process_that_holds_the_key_signs_for_the_ca(run, holder, tmp_path):
    uri = holder()
    said = run(f"ca init --profile classical --no-passphrase --identity-key-uri {uri}")
    assert f"{uri} was there already" in said
    key = (tmp_path / "k/private/identity_ca.key.pem").read_text()
    assert key.startswith("-----BEGIN PQSEC KEY URI-----\n")
    run("issue talker listener --publish a --subscribe a")
    run("revoke listener --yes")
    run("issue second --subscribe a")
    assert "/talker to /second: a" in run("verify-handshake talker second")


def test_a_holder_that_is_away_is_told(run, holder, tmp_path):
    run(f"ca init --profile classical --no-passphrase --identity-key-uri {holder()}")
    (tmp_path / "s0").unlink()
    said = run("issue talker", code=3)
    assert "the package of 'socket:' cannot give the key: FileNotFoundError" in said


def test_a_signature_by_another_key_is_refused(run, holder, tmp_path):
    run(f"ca init --profile classical --no-passphrase --identity-key-uri {holder()}")
    other = holder().removeprefix("socket:")
    (tmp_path / "s0").unlink()
    Path(other).rename(tmp_path / "s0")
    assert "does not match the certificate" in run("issue talker", code=3)


def test_a_scheme_that_no_package_handles_is_refused(run, tmp_path):
    said = run("ca init --profile classical --identity-key-uri awskms:key", code=2)
    assert "no installed packages handle keys with URIs that begin with 'awskms:'" in said
    assert not (tmp_path / "k").exists()
