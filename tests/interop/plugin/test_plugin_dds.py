"""Cyclone DDS itself with the plugin: processes, discovery, matching, data, and the wire."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from pqsec_pki.plugin import agent_status
from pqsec_pki.trial import MissingStackError, TrialRole, find, unauthenticated
from pqsec_pki.vendors.cyclone_plugins import find_cyclone_plugins
from tests.interop.conftest import LAB_PROFILES, TOPIC
from tests.interop.plugin.processes import DOMAIN, PATIENCE, REFUSAL, Stage, logs, met
from tests.interop.roots import TRIXIE

pytestmark = pytest.mark.interop

OURS, OWN_AC, CYCLONES = "ours ours", "ours cyclones", "cyclones cyclones"
STOCK_PEERS = 'peers = "stock"\n'
NO_HANG = 300.0
"""Seconds for a process that has to end by itself within three."""
HOST = Path(__file__).with_name("gil_host.py")


@pytest.fixture(scope="module")
def installation(requires):
    try:
        return find("cyclonedds")
    except MissingStackError as error:
        return requires(None, "Cyclone DDS to compile against", error.hint or str(error))


@pytest.fixture
def stage(installation, shim, plugins, tmp_path) -> Stage:
    """The stage; `test_...(stage, labs)` lets alice and bob of a lab meet on it."""
    return Stage(installation, shim, plugins, tmp_path)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("profile", LAB_PROFILES)
def test_data_flows_between_two_and_a_stranger_gets_nothing(stage, labs, profile):
    lab = labs(profile)
    outsider = unauthenticated(stage.installation, stage.receiver(lab.bob).act, stage.folder)
    went = stage.run_peers(stage.sender(lab.alice), stage.receiver(lab.bob), outsider)
    assert met(went), logs(went)
    assert went.outcomes[2].joined


@pytest.mark.parametrize("profile", ["transition", "cnsa2"])
def test_data_flows_after_messages_of_the_second_version_alone(stage, labs, settings, profile):
    lab = labs(profile)
    sides = (settings(each, "wire_versions = [2]\n") for each in (lab.alice, lab.bob))
    went = stage.run_peers(
        *(act(each) for act, each in zip((stage.sender, stage.receiver), sides, strict=True))
    )
    assert met(went), logs(went)


@pytest.mark.parametrize("profile", ["transition", "pq"])
def test_the_same_library_runs_in_a_newer_cyclone(stack_in, shim, labs, tmp_path, profile):
    """Debian trixie's 0.10.5, in a root file system of its own."""
    newer = stack_in("cyclonedds", "trixie")
    stage = Stage(newer, shim, find_cyclone_plugins(TRIXIE), tmp_path)
    went = stage.run_peers(stage.sender(labs(profile).alice), stage.receiver(labs(profile).bob))
    assert met(went), logs(went)


@pytest.mark.parametrize("plugins_of_sender", [OURS, OWN_AC, CYCLONES])
@pytest.mark.parametrize("profile", ["classical", "transition"])
def test_data_flows_to_and_from_cyclones_own_plugins(
    stage, labs, settings, profile, plugins_of_sender
):
    lab = labs(profile)
    alice, bob = (settings(each, STOCK_PEERS) for each in (lab.alice, lab.bob))
    other = CYCLONES if plugins_of_sender != CYCLONES else OURS
    went = stage.run_peers(
        stage.sender(alice, plugins=plugins_of_sender), stage.receiver(bob, plugins=other)
    )
    assert met(went), logs(went)


def test_the_links_take_the_place_of_cyclones_own_by_name(stage, labs):
    """Which is all that can be done where ROS 2 names the libraries."""
    lab = labs("pq")
    went = stage.run_peers(stage.sender(lab.alice, plugins="named named"), stage.receiver(lab.bob))
    assert met(went), logs(went)


def test_a_post_quantum_identity_works_with_cyclones_access_control(stage, labs, enclave):
    """It reads no more of a certificate than its subject; documents must be classical."""
    lab, classical = labs("pq"), labs("classical")
    names = ("permissions_ca.cert.pem", "governance.p7s", "permissions.p7s")
    alice, bob = (enclave(folder, {}) for folder in (lab.alice, lab.bob))
    for folder, source in ((alice, classical.alice), (bob, classical.bob)):
        for name in names:
            (folder / name).unlink()
            (folder / name).write_bytes((source / name).read_bytes())
    went = stage.run_peers(stage.sender(alice, plugins=OWN_AC), stage.receiver(bob, plugins=OWN_AC))
    assert met(went), logs(went)


def test_nothing_comes_from_one_without_credentials(stage, labs):
    outsider = unauthenticated(
        stage.installation, stage.sender(labs("pq").alice).act, stage.folder, "x"
    )
    went = stage.run_strangers(outsider, stage.receiver(labs("pq").bob))
    assert went.outcomes[1].joined
    assert went.outcomes[1].received is None


def test_nothing_passes_between_two_cas_of_the_same_name(stage, labs, other_labs):
    said = "is not signed by this CA"
    went = stage.run_strangers(
        stage.sender(labs("pq").alice), stage.receiver(other_labs("pq").bob), said=said
    )
    assert all(each.joined for each in went.outcomes)
    assert not met(went)
    assert said in logs(went)


def test_nothing_passes_to_one_with_cyclones_own_plugin_unless_allowed(stage, labs):
    lab = labs("transition")
    went = stage.run_strangers(stage.sender(lab.alice), stage.receiver(lab.bob, plugins=CYCLONES))
    assert all(each.joined for each in went.outcomes)
    assert not met(went)


def test_a_topic_that_is_not_granted_cannot_be_made(stage, labs):
    lab = labs("pq")
    went = stage.run_peers(stage.sender(lab.alice), stage.receiver(lab.bob), topic="rt/secret")
    assert went.outcomes[0].refused
    assert went.outcomes[0].refused.startswith("topic")
    assert "check_create_topic refused" in stage.shim.log


@pytest.mark.slow
def test_two_meet_though_packets_are_lost(stage, labs):
    lab = labs("pq")
    went = stage.run_peers(
        stage.sender(lab.alice, loss=0.02), stage.receiver(lab.bob, loss=0.02), seconds=60
    )
    assert met(went), logs(went)


@contextmanager
def running(stage: Stage, role: TrialRole, seconds: float = 3):
    """A peer as a process, which ends by itself after so many seconds at most."""
    words = [role.act.value, str(DOMAIN), TOPIC, role.text, str(seconds)]
    with hosted([*stage.program, *words], role.environment) as process:
        yield process


@contextmanager
def hosted(command, environment):
    """A process that lets the agent take three seconds for a call; what it says is in stdout."""
    process = subprocess.Popen(
        command,
        env=os.environ | environment | {"PQSEC_AGENT_TIMEOUT": "3000"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def ended(process) -> str:
    """What it said, having ended by itself; subprocess.TimeoutExpired if it hangs."""
    said, _ = process.communicate(timeout=NO_HANG)
    assert process.returncode in {0, 3}, said
    return said


def wait_for(process, word: str) -> None:
    assert any(line.startswith(word) for line in iter(process.stdout.readline, ""))


def test_a_host_whose_agent_is_killed_goes_on_and_meets_nobody(stage, labs):
    lab = labs("pq")
    with running(stage, stage.receiver(lab.bob), seconds=PATIENCE) as receiver:
        wait_for(receiver, "created")
        stage.shim.kill_agent()
        with running(stage, stage.sender(lab.alice), seconds=PATIENCE) as sender:
            wait_for(sender, "joined")  # with a new agent
            said = until(receiver, "the agent is gone")
            time.sleep(REFUSAL)
            assert receiver.poll() is None
            receiver.kill()
            said += receiver.stdout.read()
    assert "received" not in said


def until(process, words: str) -> str:
    """What it says until it has said that."""
    said = ""
    for line in iter(process.stdout.readline, ""):
        said += line
        if words in line:
            return said
    raise AssertionError(said)


def test_data_flows_on_when_the_agent_is_killed(stage, labs):
    lab = labs("pq")
    role = stage.sender(lab.alice)
    with (
        running(stage, role, seconds=8) as sender,
        running(stage, stage.receiver(lab.bob), seconds=8) as receiver,
    ):
        wait_for(sender, "matched")
        stage.shim.kill_agent()
        assert f"received {role.text}" in ended(receiver)


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("after", [0.0, 0.05, 0.12])
def test_no_host_hangs_or_crashes_when_the_agent_dies_or_hangs_at_any_time(stage, labs, after, how):
    lab = labs("pq")
    with (
        running(stage, stage.receiver(lab.bob), seconds=1.5) as receiver,
        running(stage, stage.sender(lab.alice), seconds=1.5) as sender,
    ):
        wait_for(sender, "joined")
        agent = agent_status(stage.shim.place)
        assert agent.workers
        time.sleep(after)
        for each in (agent.process, *agent.workers):
            os.kill(each, how)
        try:
            ended(receiver)
            ended(sender)
        finally:
            for each in (agent.process, *agent.workers):
                stage.shim.kill_agent(each)


@pytest.mark.slow
def test_an_agent_that_hangs_makes_a_participant_fail_not_hang(stage, labs):
    lab = labs("pq")
    with running(stage, stage.sender(lab.alice), seconds=1) as sender:
        ended(sender)
    agent = stage.shim.wait_for_agent()
    os.kill(agent, signal.SIGSTOP)
    try:
        with running(stage, stage.receiver(lab.bob)) as receiver:
            assert "the agent does not answer within 3000 ms" in ended(receiver)
    finally:
        stage.shim.kill_agent(agent)


@pytest.mark.slow
def test_an_agent_of_ones_own_is_for_one_process_and_ends_with_it(stage, labs):
    lab = labs("pq")
    role = stage.sender(lab.alice)
    alone = TrialRole(
        name="alone",
        act=role.act,
        text=role.text,
        environment=role.environment | {"PQSEC_AGENT": "private"},
    )
    with running(stage, alone, seconds=2) as sender:
        wait_for(sender, "joined")
        socket = stage.shim.place.folder / f"agent-{sender.pid}.sock"
        assert socket.exists()
        ended(sender)
    until = time.monotonic() + 60
    while socket.exists() and time.monotonic() < until:
        time.sleep(0.05)
    assert not socket.exists()


@pytest.mark.slow
def test_a_host_that_keeps_the_interpreter_lock_does_not_hang(stage, labs):
    """As rclpy does in dds_delete: fifty participants, deleted at every stage of a handshake."""
    lab = labs("pq")
    with running(stage, stage.receiver(lab.bob), seconds=60):
        done = subprocess.run(
            [sys.executable, HOST, str(DOMAIN), "50"],
            env=os.environ | stage.environment(lab.alice),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["50"]
