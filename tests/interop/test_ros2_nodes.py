"""Real nodes of ROS 2 run secured with what `export` writes, and end where we say they will.

The plugins are Cyclone DDS's own; plugin/test_plugin_ros2.py has the same with ours.
"""

from pathlib import Path

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.certificates import Reason
from pqsec_pki.documents import permissions_to_yaml, ros, sros2
from pqsec_pki.lifecycle import revoke
from pqsec_pki.trial import unique_text
from pqsec_pki.vendors.enclave import SIX
from pqsec_pki.vendors.messages import recognise
from tests.interop.conftest import DOMAINS, LAB_PROFILES, YEAR
from tests.interop.crew import Crew
from tests.interop.nodes import Does, ended

pytestmark = pytest.mark.interop

HERE = Path(__file__).parent
FOUND = "Found security directory: {folder}"
DENIED = "failed to create topic [{topic}] for unknown reasons"


@pytest.fixture(scope="session")
def crew(tmp_path_factory, now) -> Crew:
    return Crew.create(tmp_path_factory.mktemp("crew"), LAB_PROFILES["transition"], now)


@pytest.fixture
def role(nodes, crew):
    """role(Does.SEND, "/talker") is a secured process."""

    def made(does, *names, enclave="", **choices):
        script = crew.script(enclave or names[0])
        return nodes.role(does, *names, enclave=enclave, script=script, **choices)

    return made


@pytest.fixture
def lives(nodes, role):
    """lives(Does.IDLE, "/talker") is how a node fares that is alone."""

    def made(does, *names, **choices):
        return nodes.one(role(does, *names, **choices))

    return made


def explained(outcome) -> list[str]:
    return [found.message.texts[0] for found in recognise(outcome.log, stack="ros2")]


def test_two_nodes_talk_and_nobody_can_read_it(nodes, role, crew, requires):
    talker, listener = (
        role(Does.SEND, "/talker", text=unique_text()),
        role(Does.RECEIVE, "/listener"),
    )
    went = nodes.run_peers(talker, listener)
    assert went.outcomes[1].received == talker.text, went.outcomes
    for outcome in went.outcomes:
        folder = crew.keystore.root / "enclaves" / outcome.role.name.strip("/")
        assert FOUND.format(folder=folder) in outcome.log
    assert ended(went.outcomes[1])
    wire = requires(went.wire, "a wire to watch", "run the tests as root")
    assert wire.packets
    assert not wire.readable


@pytest.mark.slow
def test_without_the_script_the_text_can_be_read(nodes, requires):
    talker = nodes.role(Does.SEND, "/talker", text=unique_text())
    went = nodes.run_peers(talker, nodes.role(Does.RECEIVE, "/listener"))
    assert went.outcomes[1].received == talker.text, went.outcomes
    assert requires(went.wire, "a wire to watch", "run the tests as root").readable


@pytest.mark.slow(but=1)
def test_an_unsecured_node_gets_nothing_while_a_secured_one_does(nodes, role):
    talker = role(Does.SEND, "/talker", text=unique_text())
    plain = nodes.role(Does.RECEIVE, "/plain", unauthenticated=True)
    went = nodes.run_peers(talker, role(Does.RECEIVE, "/listener"), plain)
    assert went.outcomes[1].received == talker.text, went.outcomes
    assert went.outcomes[2].joined
    assert went.outcomes[2].received is None


@pytest.mark.slow
def test_a_secured_node_takes_nothing_from_an_unsecured_one(nodes, role):
    plain = nodes.role(Does.SEND, "/plain", text=unique_text())
    went = nodes.run_strangers(plain, role(Does.RECEIVE, "/listener"))
    assert all(each.joined for each in went.outcomes)
    assert went.outcomes[1].received is None


@pytest.mark.slow
def test_a_node_of_another_keystore_with_the_same_names_gets_nothing(nodes, role, tmp_path, now):
    rogue = Crew.create(tmp_path, LAB_PROFILES["transition"], now)
    listener = nodes.role(Does.RECEIVE, "/listener", script=rogue.script("/listener"))
    said = "unable to get local issuer certificate"
    went = nodes.run_strangers(role(Does.SEND, "/talker", text=unique_text()), listener, said=said)
    assert all(each.joined for each in went.outcomes)
    assert went.outcomes[1].received is None
    assert said in went.outcomes[1].log


def test_a_topic_that_is_not_granted_ends_the_node(lives):
    outcome = lives(Does.RECEIVE, "/stranger")
    assert DENIED.format(topic="rt/chatter") in outcome.log
    assert DENIED in explained(outcome)
    assert not ended(outcome)


@pytest.mark.slow
def test_many_nodes_live_in_one_enclave(lives):
    names = ["/robot/drive", "/robot/sensors/imu", "/robot/watchdog"]
    assert ended(lives(Does.IDLE, *names, enclave="/robot/base"))


def test_nodes_live_whose_names_begin_as_a_pattern_says(lives):
    """Those of ROS 2's own command line have the number of their process in them."""
    outcome = lives(Does.RECEIVE, "/_ros2cli_4242", enclave="/desk")
    assert outcome.joined, outcome.log
    assert ended(outcome)


def test_a_node_that_the_enclave_does_not_name_ends(lives):
    outcome = lives(Does.IDLE, "/robot/drive", "/robot/spy", enclave="/robot/base")
    assert outcome.refused
    assert not ended(outcome)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    ("does", "name"), [(Does.CLOCK, "/clocked"), (Does.MANAGED, "/managed")], ids=str
)
def test_the_words_of_a_policy_are_enough_for(lives, does, name):
    outcome = lives(does, name)
    assert ended(outcome), outcome.log


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    ("does", "topic"),
    [(Does.CLOCK, "rt/clock"), (Does.MANAGED, "rt/talker/transition_event")],
    ids=str,
)
def test_without_these_words_the_node_ends(lives, does, topic):
    outcome = lives(does, "/talker")
    assert DENIED.format(topic=topic) in outcome.log
    assert not ended(outcome)


@pytest.mark.slow
def test_parameters_of_another_node_can_be_read(nodes, role):
    server, client = role(Does.IDLE, "/talker"), role(Does.CALL, "/tuner")
    went = nodes.run_peers(client, server, topic="/talker")
    assert "use_sim_time" in (went.outcomes[0].received or ""), went.outcomes


@pytest.mark.slow
def test_an_action_works(nodes, role):
    went = nodes.run_peers(role(Does.ACT, "/guest"), role(Does.SERVE, "/cook"), topic="/cook")
    assert went.outcomes[0].received == "[1, 1, 2]", went.outcomes


@pytest.fixture(params=[True, False], ids=["completed", "as it is"])
def migrated(request, crew):
    """Whether permissions were completed, which are made of a policy of SROS2 for /robot1/nav."""
    now = crew.lab.now
    value = sros2.permissions_of(
        sros2.read_policy(HERE / "nav.policy.xml"),
        domains=DOMAINS,
        not_before=now - YEAR,
        not_after=now + YEAR,
        node_minimum=request.param,
    )
    crew.issue(permissions_to_yaml(value))
    return request.param


@pytest.mark.slow(but=1)
def test_a_policy_of_sros2_is_enough_once_it_is_completed(lives, migrated):
    """It has what SROS2's samples have for each node; the nodes are in namespaces."""
    names = ["/robot1/planner", "/robot1/costmap/costmap", "/robot1/manager"]
    outcome = lives(Does.MANAGED, *names, enclave="/robot1/nav")
    assert ended(outcome) is migrated, outcome.log
    assert migrated or DENIED.format(topic="rt/rosout") in outcome.log


@pytest.mark.slow
def test_a_node_that_was_revoked_is_let_in_by_none_with_the_list(nodes, tmp_path, now):
    """It has hidden the list from itself: with it, it would not start."""
    crew = Crew.create(tmp_path, LAB_PROFILES["transition"], now)
    keystore, authorities = crew.keystore, crew.lab.authorities
    revoke(keystore, authorities, ["/talker"], reason=Reason.KEY_COMPROMISE, now=now)
    (keystore.root / "enclaves" / "talker" / "crl.pem").unlink()
    talker = nodes.role(Does.SEND, "/talker", script=crew.script("/talker"), text=unique_text())
    listener = nodes.role(Does.RECEIVE, "/listener", script=crew.script("/listener"))
    went = nodes.run_strangers(talker, listener, said="certificate revoked")
    assert went.outcomes[1].received is None
    assert "certificate revoked" in went.outcomes[1].log


NEEDED = [
    (way, topic)
    for way, topics in ros.node_minimum("/talker")._asdict().items()
    for topic in topics
]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(("way", "topic"), NEEDED)
def test_a_node_without_one_of_its_topics_ends(lives, crew, way, topic):
    """That each is needed is measured, and that no other is: the other tests' nodes live."""
    needs = ros.node_minimum("/talker")._asdict()
    needs[way] = [each for each in needs[way] if each != topic]
    grant = f"name: /bare, publish: {list(needs['publish'])}, subscribe: {list(needs['subscribe'])}"
    crew.issue(f"grants: [{{{grant}}}]".encode())
    outcome = lives(Does.IDLE, "/talker", enclave="/bare")
    assert not ended(outcome), outcome.log
    side = {"publish": "writer", "subscribe": "reader"}[way]
    denied = f"failed to create {side}" if topic == ros.DISCOVERY else DENIED.format(topic=topic)
    assert denied in outcome.log


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", SIX)
def test_one_of_the_six_files_is_missing_and_not_named(nodes, role, crew, name):
    starting = role(Does.IDLE, "/talker")
    file = crew.keystore.root / "enclaves" / "talker" / name
    away = file.rename(file.with_suffix(".away"))
    try:
        outcome = nodes.one(starting)
    finally:
        away.rename(file)
    assert "could not find all security files" in explained(outcome)
    assert not ended(outcome)


def test_an_encrypted_key_ends_the_node(nodes, role, crew):
    starting = role(Does.IDLE, "/talker")
    file = crew.keystore.root / "enclaves" / "talker" / "key.pem"
    plain = file.read_bytes()
    file.write_bytes(private_key_pem(load_private_key(plain), b"open sesame"))
    try:
        outcome = nodes.one(starting)
    finally:
        file.write_bytes(plain)
    assert outcome.refused
    assert "decrypt" in outcome.log


def test_a_domain_that_governance_does_not_have(lives):
    outcome = lives(Does.IDLE, "/talker", ROS_DOMAIN_ID="99")
    assert "Could not find domain 99 in governance" in outcome.log
    assert not ended(outcome)
