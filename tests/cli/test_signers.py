"""CA keys that another process holds, by the package in examples/extension."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from pqsec_pki.algorithms import SIGNATURES, private_key_pem
from tests.cli.conftest import EXTENSION

LONG_ENOUGH = 600
"""Times a tenth of a second."""


@pytest.fixture
def run(extension, tmp_path):
    def run(line, code=0):
        done = extension(tmp_path, f"-k k {line}")
        assert done.code == code, done
        return done.out + done.err

    return run


@pytest.fixture
def holder(tmp_path):
    """holder(algorithm) starts a process that holds a new key, and gives its URI."""
    started = []

    def start(algorithm="ecdsa-p256"):
        key, place = tmp_path / f"key{len(started)}", tmp_path / f"s{len(started)}"
        key.write_bytes(private_key_pem(SIGNATURES.named(algorithm).generate()))
        command = [sys.executable, EXTENSION / "signing_process.py", key, place]
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
