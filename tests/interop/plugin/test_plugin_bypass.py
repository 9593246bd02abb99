"""Peers that let themselves do what they may not: the other side keeps the rules."""

import shlex
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from pqsec_pki.plugin import build
from tests.interop.conftest import TOPIC, permissions_of
from tests.interop.plugin.hosts import cyclonedds
from tests.interop.plugin.processes import PATIENCE, REFUSAL, Stage, logs, met

pytestmark = pytest.mark.interop

OTHER = "rt/another"
LAX = Path(__file__).with_name("lax_agent.py")
LIES = list(product(("sender", "receiver"), ("ours ours", "ours cyclones")))


@pytest.fixture
def stage(requires, shim, plugins, tmp_path) -> Stage:
    folder = tmp_path / "configurations"
    folder.mkdir()
    found = requires(cyclonedds(), "Cyclone DDS to compile against", "cyclonedds-dev and -tools")
    return Stage(found, shim, plugins, folder)


@pytest.fixture
def outcome(stage):
    """outcome(sender, receiver) is whether they met, and what agents logged of it.

    On a busy machine they may need longer until either.
    """

    def play(*roles):
        for seconds in (REFUSAL, PATIENCE):
            before = len(stage.shim.log)
            went = stage.run_peers(*roles, seconds=seconds)
            assert all(each.joined and not each.refused for each in went.outcomes), logs(went)
            log = stage.shim.log[before:]
            if met(went) or "check_remote" in log or "validate_remote" in log:
                break
        return met(went), log

    return play


@pytest.fixture
def lax(stage, tmp_path, monkeypatch) -> Stage:
    """The same stage with a library that starts a lax agent."""
    starter = tmp_path / "python"
    words = shlex.join([sys.executable, str(LAX)])
    starter.write_text(f'#!/bin/sh\nshift 3\nexec {words} "$@"\n')  # without -I -m MODULE
    starter.chmod(0o755)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "executable", str(starter))
        folder = build(tmp_path / "lax").library.parent
    return replace(stage, shim=replace(stage.shim, folder=folder))


@pytest.fixture
def bypassing(lax, labs, enclave):
    """bypassing("sender", topic) may use that topic alone, and has a lax agent of its own."""

    def role(who, topic):
        lab = labs("pq")
        make, folder = {"sender": (lax.sender, lab.alice), "receiver": (lax.receiver, lab.bob)}[who]
        document = permissions_of(f"/lab/{folder.name}", lab.now)
        signed = lab.sign(document.replace(TOPIC.encode(), topic.encode()))
        made = make(enclave(folder, {"permissions.p7s": signed}))
        return replace(made, environment={**made.environment, "PQSEC_AGENT": "private"})

    return role


@pytest.mark.slow
@pytest.mark.parametrize("topic", [OTHER, TOPIC])
def test_a_sender_that_bypasses_its_own_access_control_is_not_heard(
    outcome, stage, labs, bypassing, topic
):
    """Its handshake is good, and so are its permissions; they say nothing of that topic."""
    heard, log = outcome(bypassing("sender", topic), stage.receiver(labs("pq").bob))
    assert heard is (topic == TOPIC), log
    assert ("check_remote_datawriter refused" in log) is (topic == OTHER), log


@pytest.mark.slow
@pytest.mark.parametrize("topic", [OTHER, TOPIC])
def test_a_receiver_that_bypasses_its_own_access_control_hears_nothing(
    outcome, stage, labs, bypassing, topic
):
    heard, log = outcome(stage.sender(labs("pq").alice), bypassing("receiver", topic))
    assert heard is (topic == TOPIC), log
    assert ("check_remote_datareader refused" in log) is (topic == OTHER), log


@pytest.fixture
def self_signed(labs, other_labs, enclave):
    """self_signed(folder) has its identity, and documents of another permissions CA, classical
    so that any plugin takes them."""

    def forged(folder):
        documents = other_labs("classical").alice.with_name(folder.name)
        names = ("permissions_ca.cert.pem", "governance.p7s", "permissions.p7s")
        return enclave(folder, {name: (documents / name).read_bytes() for name in names})

    return forged


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("lie", LIES, ids=" ".join)
def test_permissions_that_a_peer_signed_itself_are_nothing(outcome, stage, labs, self_signed, lie):
    lab, (liar, whose) = labs("pq"), lie
    if liar == "sender":
        sender = stage.sender(self_signed(lab.alice), plugins=whose)
        heard, log = outcome(sender, stage.receiver(lab.bob))
    else:
        receiver = stage.receiver(self_signed(lab.bob), plugins=whose)
        heard, log = outcome(stage.sender(lab.alice), receiver)
    assert not heard
    assert "validate_remote_permissions refused: the peer's permissions" in log
