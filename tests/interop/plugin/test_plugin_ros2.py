"""Real nodes of ROS 2 with pqsec's plugin: post-quantum, and with the interpreter's lock held.

rclpy keeps that lock while Cyclone DDS deletes a participant, and Cyclone DDS waits for its
threads; the plugin of which the first nodes ran needed it in those threads, and hung.
"""

import shutil
from functools import cache

import pytest

from pqsec_pki.trial import unique_text
from pqsec_pki.vendors.messages import recognise
from tests.interop.conftest import LAB_PROFILES
from tests.interop.crew import Crew
from tests.interop.nodes import Does, ended

pytestmark = pytest.mark.interop

LIVES = (0.0, 0.03, 0.06, 0.09, 0.12, 0.15, 0.3)
"""Seconds: a handshake takes some 150 ms, most of it waiting."""


@pytest.fixture(scope="session")
def crews(tmp_path_factory, now):
    """crews("pq") is a crew of that profile, crews("pq", "rogue") another one."""
    folder = tmp_path_factory.mktemp("crews")

    @cache
    def made(profile, whose):
        return Crew.create(folder / whose / profile, LAB_PROFILES[profile], now)

    return lambda profile="pq", whose="ours": made(profile, whose)


@pytest.fixture
def role(nodes, crews, shim):
    """role(Does.SEND, "/talker") is a process with the plugin, of profile pq."""

    def made(does, name, *, crew=None, **choices):
        script = (crew or crews()).script(name, plugin=shim.folder)
        return nodes.role(does, name, script=script, **choices)

    return made


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("profile", ["transition", "hybrid", "pq", "cnsa2"])
def test_two_nodes_talk_and_nobody_can_read_it(nodes, role, crews, requires, profile):
    crew = crews(profile)
    talker = role(Does.SEND, "/talker", crew=crew, text=unique_text())
    went = nodes.run_peers(talker, role(Does.RECEIVE, "/listener", crew=crew))
    listener = went.outcomes[1]
    assert listener.received == talker.text, went.outcomes
    assert ended(listener)
    (loaded,) = [line for line in listener.log.splitlines() if line.startswith("loaded")]
    assert loaded == "loaded libdds_security_crypto.so libpqsec_dds.so"
    wire = requires(went.wire, "a wire to watch", "run the tests as root")
    assert wire.packets
    assert not wire.readable


def test_cyclones_own_plugin_makes_no_node_of_these_keys(nodes, crews):
    script = crews().script("/talker")
    outcome = nodes.one(nodes.role(Does.IDLE, "/talker", script=script))
    assert "Certificate authentication algorithm unknown" in outcome.log
    assert outcome.refused


@pytest.mark.slow
def test_a_node_of_another_domain_with_the_same_names_gets_nothing(nodes, role, crews, shim):
    rogue = role(Does.RECEIVE, "/listener", crew=crews(whose="rogue"))
    before = len(shim.place.log.read_text()) if shim.place.log.exists() else 0
    went = nodes.run_strangers(role(Does.SEND, "/talker", text=unique_text()), rogue)
    assert all(each.joined for each in went.outcomes)
    assert went.outcomes[1].received is None
    assert "is not signed by this CA" in shim.place.log.read_text()[before:]


@pytest.mark.slow
def test_an_unsecured_node_gets_nothing(nodes, role):
    plain = nodes.role(Does.RECEIVE, "/plain", unauthenticated=True)
    talker, listener = (
        role(Does.SEND, "/talker", text=unique_text()),
        role(Does.RECEIVE, "/listener"),
    )
    went = nodes.run_peers(talker, listener, plain)
    assert went.outcomes[1].received == talker.text, went.outcomes
    assert went.outcomes[2].joined
    assert went.outcomes[2].received is None


def test_nodes_with_and_without_the_plugin_meet(nodes, role, crews):
    """If who has it says that its peers have Cyclone DDS's own."""
    crew = crews("transition", "mixed")
    (crew.keystore.root / "enclaves" / "talker" / "pqsec.toml").write_text('peers = "stock"')
    talker = role(Does.SEND, "/talker", crew=crew, text=unique_text())
    listener = nodes.role(Does.RECEIVE, "/listener", script=crew.script("/listener"))
    went = nodes.run_peers(talker, listener)
    assert went.outcomes[1].received == talker.text, went.outcomes
    assert "libdds_security_auth.so" in went.outcomes[1].log


def test_a_topic_that_is_not_granted_ends_the_node(nodes, role):
    outcome = nodes.one(role(Does.RECEIVE, "/stranger"))
    told = [each.message.texts[0] for each in recognise(outcome.log, stack="ros2")]
    assert "failed to create topic [{topic}] for unknown reasons" in told
    assert "[rt/chatter]" in outcome.log


@pytest.mark.slow
def test_an_action_works(nodes, role):
    went = nodes.run_peers(role(Does.ACT, "/guest"), role(Does.SERVE, "/cook"), topic="/cook")
    assert went.outcomes[0].received == "[1, 1, 2]", went.outcomes


@pytest.mark.slow
@pytest.mark.parametrize("does", [Does.IDLE, Does.RAISE], ids=["destroyed", "by an exception"])
def test_nodes_that_end_at_any_stage_of_a_handshake_end(nodes, role, does):
    peer, short = role(Does.IDLE, "/talker"), role(does, "/listener")
    *outcomes, constant = nodes.beside(peer, [short] * len(LIVES), *LIVES)
    for outcome in outcomes:
        assert outcome.joined, outcome.log
        assert outcome.signal is None, outcome.log
    assert constant.joined
    assert not ended(constant)
    assert does is Does.RAISE or all(map(ended, outcomes))


@pytest.mark.slow
def test_a_copy_for_a_robot_is_enough(nodes, role, crews, shim, tmp_path):
    robot = tmp_path / "robot"
    place = robot / "enclaves" / "listener"
    made = crews("transition").script("/listener", plugin=shim.folder, at=place).parent
    shutil.move(made, robot)
    talker = role(Does.SEND, "/talker", crew=crews("transition"), text=unique_text())
    listener = nodes.role(Does.RECEIVE, "/listener", script=robot / "ros2.sh")
    went = nodes.run_peers(talker, listener)
    assert went.outcomes[1].received == talker.text, went.outcomes
    assert f"Found security directory: {place}" in went.outcomes[1].log


@pytest.mark.slow
def test_nodes_live_again_when_the_agent_was_killed(nodes, role, shim):
    assert ended(nodes.one(role(Does.IDLE, "/talker")))
    shim.kill_agent()
    assert ended(nodes.one(role(Does.IDLE, "/talker")))
