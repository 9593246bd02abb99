"""Participants whose keys are in a real PKCS#11 token: the agent signs their handshakes with it."""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pqsec_pki.plugin import AgentFolder, stop_agent
from pqsec_pki.trial import MissingStackError, TrialRole, find, running
from tests.interop.conftest import TOPIC
from tests.interop.cyclone import RefusedError, participant
from tests.interop.plugin.conftest import Shim, children
from tests.interop.plugin.couple import couple
from tests.interop.plugin.processes import PATIENCE, Stage, logs, met
from tests.interop.tokens import SPY

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

NAMES = ("alice", "bob")


@pytest.fixture
def own(shim, token, monkeypatch) -> Shim:
    """The plugin, with an agent that starts with the token's library and PIN."""
    runtime = Path(tempfile.mkdtemp(prefix="pqsec-"))  # a socket's path must be short
    monkeypatch.setenv("HOME", str(token.home))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    monkeypatch.setenv("PQSEC_PKCS11_MODULE", str(token.module))
    monkeypatch.setenv("PQSEC_PIN_FILE", str(token.pin_file))
    place = AgentFolder.of(os.environ)
    yield Shim(shim.folder, place)
    stop_agent(place)
    shutil.rmtree(runtime, ignore_errors=True)


@pytest.fixture
def enclaves(own, token) -> list[Path]:
    """Those of two whose keys are in the token."""
    return issued(token, "classical")


def issued(token, profile) -> list[Path]:
    token.pqsec("ca", "init", "--profile", profile, "--no-passphrase", "--domain", "0-10")
    topics = ("--publish", TOPIC, "--subscribe", TOPIC)
    for name in NAMES:
        place = ("--participant-key-uri", f"pkcs11:token=lab;object={name}")
        token.pqsec("issue", name, *place, *topics)
    return [token.folder / "k/enclaves" / name for name in NAMES]


@pytest.fixture
def stage(own, requires, plugins, tmp_path) -> Stage:
    try:
        found = find("cyclonedds")
    except MissingStackError as error:
        found = requires(None, "Cyclone DDS to compile against", error.hint or str(error))
    (tmp_path / "stage").mkdir()
    return Stage(found, own, plugins, tmp_path / "stage")


def test_data_flows_between_two_whose_keys_are_in_a_token(stage, enclaves):
    alice, bob = enclaves
    went = stage.run_peers(stage.sender(alice), stage.receiver(bob))
    assert met(went), logs(went)


@pytest.mark.slow
def test_a_second_key_may_be_in_a_file(stage, token):
    alice, bob = issued(token, "transition")
    assert (alice / "alt.key.pem").read_text().startswith("-----BEGIN PRIVATE KEY")
    went = stage.run_peers(stage.sender(alice), stage.receiver(bob))
    assert met(went), logs(went)


def with_uri(role: TrialRole, enclave: Path) -> TrialRole:
    """The same, whose property has the URI itself, as in DDS-Security 1.1, 9.3.1."""
    path = Path(role.environment["CYCLONEDDS_URI"].removeprefix("file://"))
    text = path.read_text()
    path.write_text(text.replace(f"file:{enclave}/key.pem", "pkcs11:token=lab;object=alice"))
    assert path.read_text() != text
    return role


@pytest.mark.slow
def test_the_property_may_have_the_uri_itself(stage, enclaves):
    alice, bob = enclaves
    went = stage.run_peers(with_uri(stage.sender(alice), alice), stage.receiver(bob))
    assert met(went), logs(went)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "words"),
    [
        ("reference", "Failed to parse certificate"),
        ("URI", "PrivateKey pkcs11 format currently not supported"),
    ],
)
def test_cyclones_own_plugin_takes_no_key_in_a_token(stage, enclaves, form, words):
    alice, bob = enclaves
    role = stage.sender(alice, plugins="cyclones cyclones")
    role = with_uri(role, alice) if form == "URI" else role
    went = stage.run_peers(role, stage.receiver(bob))
    assert went.outcomes[0].refused
    assert words in logs(went), logs(went)


def test_without_the_token_a_participant_is_refused_with_the_reason(
    stage, enclaves, token, monkeypatch
):
    monkeypatch.setattr(running, "_SETTLE", PATIENCE)  # it ends before, when both have ended
    alice, bob = enclaves
    (token.folder / "tokens").rename(token.folder / "elsewhere")
    (token.folder / "tokens").mkdir()
    went = stage.run_peers(stage.sender(alice), stage.receiver(bob))
    assert all(each.refused for each in went.outcomes)
    assert "the token 'lab' is not there" in logs(went)


def test_a_token_that_is_pulled_and_put_back_signs_again(own, enclaves, token):
    with couple(*((own.folder, each) for each in enclaves)) as two:
        two.agree(two.shake_hands())
        there, away = token.folder / "tokens", token.folder / "elsewhere"
        there.rename(away)
        there.mkdir()
        with pytest.raises(RefusedError):
            two.shake_hands()
        there.rmdir()
        away.rename(there)
        two.agree(two.shake_hands())
    with couple(*((own.folder, each) for each in enclaves)) as two:
        two.agree(two.shake_hands())


@contextmanager
def agent(own) -> Iterator[None]:
    """One that was not started by a host, and so has all variables."""
    with subprocess.Popen([sys.executable, "-m", "pqsec_pki", "agent", "run"]) as process:
        own.wait_for_agent()
        yield
        process.terminate()


def kill_workers(own) -> None:
    """The next participant gets a new worker, which remembers nothing."""
    for worker in children(own.wait_for_agent()):
        os.kill(worker, signal.SIGKILL)
    while children(own.wait_for_agent()):
        time.sleep(0.01)


def test_a_wrong_pin_is_tried_once_whatever_starts_again(own, enclaves, token, monkeypatch):
    wrong, log = token.folder / "wrong", token.folder / "spy.log"
    wrong.write_text("not-the-pin\n")
    wrong.chmod(0o600)
    settings = {
        "PQSEC_PKCS11_MODULE": SPY,
        "PKCS11SPY": token.module,
        "PKCS11SPY_OUTPUT": log,
        "PQSEC_PIN_FILE": wrong,
        "SOFTHSM2_CONF": token.environment["SOFTHSM2_CONF"],
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, str(value))
    with agent(own):
        for _ in range(3):
            with pytest.raises(RefusedError, match="PIN"), participant(own.folder, enclaves[0]):
                pass
            kill_workers(own)
    assert len(re.findall(r"^\d+: C_Login$", log.read_text(), re.MULTILINE)) == 1
