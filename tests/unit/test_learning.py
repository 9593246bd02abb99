"""Permissions proposed from traces of Cyclone DDS and from `ros2 node info`."""

import json
import re
import shlex
from pathlib import Path

import pytest

from pqsec_pki.access import Action
from pqsec_pki.documents import permissions_from_yaml, ros
from pqsec_pki.documents.parts_yaml import node_as_yaml
from pqsec_pki.documents.ros import Endpoints
from pqsec_pki.errors import FileError, MalformedError, UsageError
from pqsec_pki.learning import (
    Endpoint,
    SeenParticipant,
    compare,
    document_of,
    propose,
    proposing,
    read_recordings,
)
from pqsec_pki.learning import recording as reading
from pqsec_pki.learning.cyclone_trace import CycloneTrace
from tests.unit.keystores import NOW, made

VECTORS = Path(__file__).parent.parent / "vectors" / "learning"
KITCHEN, PARTITIONS, NODES, MONITOR = (
    VECTORS / name for name in ("kitchen.log", "partitions.log", "nodes.txt", "monitor.json")
)
LINE = (
    "1795417423.769100 [0]     python: WRITER 1:2:3:303 QOS={user_data=0<>,"
    'topic_name="Square",type_name="lab::Sample",partition={}}'
)


def topics(participant, action):
    return {each.topic for each in participant.endpoints if each.action is action}


def proposed(*participants):
    return propose(participants, validity="90d", now=NOW)


def proposal_of(*endpoints, nodes=()):
    seen = SeenParticipant(name="/arm", nodes=nodes, endpoints=frozenset(endpoints))
    [found] = proposed(seen).proposals
    return found


def recorded(tmp_path, text, **options):
    path = tmp_path / "recorded"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_recordings([path], **options)


def test_a_trace_of_cyclone_dds_shows_nodes_on_fast_dds():
    found = read_recordings([KITCHEN])
    assert not found.unread
    assert not found.left_out
    by_name = {each.name: each for each in found.participants}
    # The enclave names a participant; without one (`/`), its first node does.
    assert list(by_name) == ["/guest", "/kitchen/cook", "/observer"]
    assert by_name["/kitchen/cook"].nodes == ("/cook",)
    server, client = ros.action_server("/cook"), ros.action_client("/cook")
    assert {*server.publish} <= topics(by_name["/kitchen/cook"], Action.PUBLISH)
    assert {*client.subscribe} <= topics(by_name["/guest"], Action.SUBSCRIBE)
    minimum = ros.node_minimum("/observer")
    assert topics(by_name["/observer"], Action.PUBLISH) == {*minimum.publish}
    assert topics(by_name["/observer"], Action.SUBSCRIBE) == {*minimum.subscribe}
    assert {each.domain for seen in found.participants for each in seen.endpoints} == {0}


def test_a_proposal_has_the_words_of_ros_and_allows_nothing_else():
    found = read_recordings([KITCHEN])
    result = proposed(*found.participants)
    text = document_of(result.proposals, ["review it"], {"/guest": ["new"]})
    assert "      - node: /cook\n        action_servers:\n          - /cook\n" in text
    assert text.startswith("# review it\ngrants:\n  # new\n  - name: /guest\n")
    grants = permissions_from_yaml(text.encode(), now=NOW).grants
    assert grants == tuple(each.grant for each in result.proposals)
    for grant, seen in zip(grants, found.participants, strict=True):
        [rule] = grant.rules
        assert {*rule.publish[0].topics} == topics(seen, Action.PUBLISH)
        assert {*rule.subscribe[0].topics} == topics(seen, Action.SUBSCRIBE)


def test_the_output_of_ros2_node_info_is_read_as_it_is():
    found = read_recordings([NODES], domain=7)
    assert not found.unread
    assert [each.name for each in found.participants] == ["/clocked", "/cook", "/lift/second"]
    texts = [each.text for each in proposed(*found.participants).proposals]
    assert "use_sim_time: true" in texts[0]
    assert "action_servers:\n          - /cook" in texts[1]
    assert texts[2].endswith("    domains: 7\n    nodes:\n      - /lift/second\n")


def without_domains(endpoints):
    return {(each.action, each.topic, each.partitions) for each in endpoints}


def test_a_dump_of_fast_dds_monitor_shows_what_a_trace_shows():
    found = read_recordings([MONITOR])
    assert (found.left_out, found.unread) == ((), ())
    assert {each.domain for seen in found.participants for each in seen.endpoints} == {3}
    seen = {each.name: each for each in found.participants}
    traced = {each.name: each for each in read_recordings([KITCHEN]).participants}
    assert list(seen) == ["/guest", "/kitchen/cook"]
    for name, participant in seen.items():
        assert participant.nodes == traced[name].nodes
        assert without_domains(participant.endpoints) == without_domains(traced[name].endpoints)


def changed(tmp_path, change, **options):
    """What is read of the dump after that change."""
    dump = json.loads(MONITOR.read_text())
    change(dump)
    return recorded(tmp_path, json.dumps(dump), **options)


def without(kind):
    return lambda dump: dump.pop(kind)


def with_(kind, **values):
    """A change of all entities of that kind."""

    def change(dump):
        for each in dump[kind].values():
            each.update(values)

    return change


def test_a_dump_shows_partitions_processes_and_domains_of_discovery_servers(tmp_path):
    def change(dump):
        with_("participants", name="RTPSParticipant", process="7", qos=None)(dump)
        with_("domains", name="44.53.00.5f.45.50.52.4f.53.49.4d.41")(dump)
        with_("datawriters", qos={"partition": ["floor2", "floor1"]})(dump)
        with_("datareaders", qos={"partition": ["floor2", "floor1"]})(dump)
        dump["processes"]["7"] = {"name": "player"}

    found = changed(tmp_path, change, domain=9)
    points = {point for each in found.participants for point in each.endpoints}
    assert {each.domain for each in points} == {9}
    assert {each.partitions for each in points} == {("floor1", "floor2")}
    assert [each.label for each in found.participants] == ["player", "player"]


def test_enclaves_that_a_dump_does_not_have_whole_are_not_used(tmp_path):
    for data in ("656e636c6176653d2f61", "0" + b"enclave=/a;".hex(), "", None, [], "zz"):
        change = with_("participants", qos={"user_data": data})
        assert [each.name for each in changed(tmp_path, change).participants] == ["/cook", "/guest"]


BROKEN_DUMPS = {
    "no participants": (lambda dump: dump["participants"].clear(), "has no participant"),
    "without participants": (without("participants"), "not a dump of Fast DDS"),
    "without topics": (without("topics"), "not a dump of Fast DDS"),
    "list": (lambda dump: dump.update(topics=[]), "not a dump of Fast DDS"),
    "text": (lambda dump: dump.update(topics={"1": "x"}), "not a dump of Fast DDS"),
    "topic": (with_("datareaders", topic="1"), "datareaders, [0-9]+: its topic is not in the dump"),
    "no topic": (with_("datawriters", topic=["x"]), "datawriters, [0-9]+: its topic is not in"),
    "no name": (with_("topics", name=7), "its topic is not in the dump"),
    "owner": (with_("datawriters", participant="x"), "its participant is not in the dump"),
    "domain": (with_("participants", domain="7"), "its domain is not in the dump"),
    "other domain": (with_("domains", name="231"), "'231' is not a domain from 0 to 230"),
    "GUID": (with_("datawriters", guid="1"), "it has no GUID"),
    "partitions": (with_("datareaders", qos={"partition": [1]}), "its partitions cannot be read"),
}


@pytest.mark.parametrize("name", BROKEN_DUMPS)
def test_a_dump_that_is_not_complete_is_refused(tmp_path, name):
    change, message = BROKEN_DUMPS[name]
    with pytest.raises(MalformedError, match=message):
        changed(tmp_path, change)


@pytest.mark.parametrize("number", [5, True, None, ["x"], {"a": 1}])
def test_a_dump_whose_ids_are_not_texts_is_read_or_refused(tmp_path, number):
    def change(dump):
        with_("datawriters", participant=number)(dump)
        dump["participants"][str(number)] = next(iter(dump["participants"].values()))

    assert changed(tmp_path, change).participants


@pytest.mark.parametrize("kind", ["participants", "processes"])
@pytest.mark.parametrize("name", [["x"], {"a": 1}, 7])
def test_names_in_a_dump_that_are_not_texts_are_none(tmp_path, kind, name):
    """They ended it with a traceback."""

    def change(dump):
        with_("participants", name="Unknown", qos={})(dump)
        with_(kind, name=name)(dump)
        dump["datawriters"].clear()
        dump["datareaders"].clear()

    [shown] = {each.what for each in changed(tmp_path, change).left_out}
    assert shown == "a participant"


def test_a_label_is_no_part_of_a_command_that_people_paste(tmp_path):
    def change(dump):
        with_("participants", name="x'; touch own; '", qos={})(dump)
        dump["datareaders"].clear()

    [why] = {each.reason for each in changed(tmp_path, change).left_out}
    _, _, option = why.partition("--name ")
    assert shlex.split(option) == ["x'; touch own; '=/NAME"]


@pytest.mark.parametrize("text", ["{", "{}]", '{"a": 1}', "{" * 100_000, '{"a":' * 100_000])
def test_json_that_is_no_dump_is_refused(tmp_path, text):
    with pytest.raises(
        MalformedError, match=r"begins like JSON, and is not|not a dump of Fast DDS"
    ):
        recorded(tmp_path, text)


def test_partitions_and_participants_without_a_name():
    found = read_recordings([PARTITIONS], names={"gripper": "/arm"})
    assert [str(each).split(": ", 1)[1] for each in found.unread] == [
        "its enclave is cut: Cyclone DDS writes 100 bytes of user data"
    ]
    [lab] = found.left_out
    assert lab.what == "lab"
    assert "--name lab=/NAME" in lab.reason
    result = proposed(*found.participants)
    [rule] = result.proposals[0].grant.rules
    assert [(each.topics, each.partitions) for each in rule.publish] == [
        (("Square",), ("floor1", "floor2"))
    ]
    # A partition that is a pattern would allow others.
    assert [each.topics for each in rule.subscribe] == [("Circle",)]
    assert [each.reason for each in result.left_out] == [
        "the partition 'floor*' is a pattern: write the rule yourself"
    ]


def test_recordings_of_several_times_merge(tmp_path):
    lines = KITCHEN.read_text().splitlines(keepends=True)
    parts = [tmp_path / "one.log", tmp_path / "two.log"]
    parts[0].write_text("".join(lines[:60]))
    parts[1].write_text("".join(lines[60:]))
    whole = read_recordings([KITCHEN]).participants
    merged = read_recordings([*parts, KITCHEN]).participants
    assert merged == whole
    # The same participant in both kinds, by the name of its enclave.
    both = read_recordings([KITCHEN, NODES], names={"/cook": "/kitchen/cook"})
    by_name = {each.name: each for each in both.participants}
    assert "/cook" not in by_name
    assert by_name["/kitchen/cook"] == whole[1]


def test_the_rights_are_those_of_a_keystore_with_the_proposal(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/talker", "/spare"))
    talker = SeenParticipant(
        name="/talker",
        endpoints=frozenset(
            {Endpoint(0, Action.PUBLISH, "rt/chatter"), Endpoint(0, Action.SUBSCRIBE, "rt/new")}
        ),
    )
    stranger = SeenParticipant(name="/stranger", endpoints=talker.endpoints)
    learned = compare(keystore, proposed(talker, stranger).proposals, now=NOW)
    own, unknown = learned.comparisons
    assert own.known
    assert own.not_granted == (
        "publish 'rt/chatter' on domain 0",
        "subscribe 'rt/new' on domain 0",
    )
    assert own.never_seen == ("publish 'x' on domain 0",)
    assert not unknown.known
    assert unknown.not_granted
    assert learned.never_seen == ("/spare",)
    assert not learned.ok


def test_several_domains_have_their_own_rules():
    alike = [Endpoint(domain, Action.PUBLISH, "a") for domain in (0, 3)]
    assert "rules" not in proposal_of(*alike).text
    other = Endpoint(3, Action.SUBSCRIBE, "b")
    rules = proposal_of(*alike, other).grant.rules
    assert [(str(each.domains), bool(each.subscribe)) for each in rules] == [
        ("0", False),
        ("3", True),
    ]


def test_topics_of_several_nodes_are_given_to_none_unless_named_for_it():
    nodes = ("/robot/drive", "/robot/arm")
    state = ros.lifecycle_node("/robot/arm")
    points = [
        *(Endpoint(0, Action.PUBLISH, topic) for topic in (*state.publish, "rt/odom")),
        *(Endpoint(0, Action.SUBSCRIBE, topic) for topic in state.subscribe),
    ]
    text = proposal_of(*points, nodes=nodes).text
    assert "      - /robot/drive\n      - node: /robot/arm\n        lifecycle: true\n" in text
    assert "    publish:\n      - rt/odom\n" in text


def test_half_of_a_service_is_not_completed():
    """Who only listens to requests or to feedback must not get the right to call or to answer."""
    heard = ("rq/resetRequest", "rt/cook/_action/feedback", "rq/cook/_action/send_goalRequest")
    item, left = node_as_yaml("/spy", Endpoints(publish=(), subscribe=heard))
    assert item == {"node": "/spy", "subscribe": ["/cook/_action/feedback"]}
    assert left.subscribe == ("rq/cook/_action/send_goalRequest", "rq/resetRequest")


@pytest.mark.parametrize(
    ("topic", "reason"),
    [("rt/*", "pattern"), ("rt/[ab]", "pattern"), ("rt/\x1b[2J", "pattern"), ("rt/\x07", "cannot")],
)
def test_hostile_topics_are_not_granted(topic, reason):
    points = frozenset({Endpoint(0, Action.PUBLISH, each) for each in (topic, "rt/fine")})
    result = proposed(SeenParticipant(name="/arm", endpoints=points))
    [grant] = [each.grant for each in result.proposals]
    assert grant.rules[0].publish[0].topics == ("rt/fine",)
    [left] = result.left_out
    assert reason in left.reason
    assert left.what.isprintable()


BROKEN = {
    "cut line": (LINE[:-40], "cut"),
    "quote in a topic": (LINE.replace("Square", 'Squ"are'), "cannot be read"),
    "partition without an end": (LINE.replace("partition={}", 'partition={"a'), "cannot be read"),
    "domain": (LINE.replace("[0]", "[231]"), "not a domain"),
    "no domain": (LINE.replace("[0]", "[]"), "not a domain"),
    "long domain": (LINE.replace("[0]", f"[{'9' * 500}]"), "not a domain"),
    "long line": (LINE.replace("Square", 2048 * "a"), "longer than 2048 characters"),
    "other text": ("hello", "not a line of a Cyclone DDS trace"),
}


def test_lines_that_cannot_be_read_are_named(tmp_path):
    for what, (line, reason) in BROKEN.items():
        found = recorded(tmp_path, f"{LINE}\n\n{line}\n", names={})
        assert [each.line for each in found.unread] == [3], what
        assert reason in found.unread[0].reason, what
        assert found.unread[0].path.name == "recorded"


INFO = "/talker\n" + "".join(
    f"  {heading}:\n{use}\n"
    for heading, use in (
        ("Subscribers", ""),
        ("Publishers", "    /chatter: std_msgs/msg/String"),
        ("Service Servers", ""),
        ("Service Clients", ""),
        ("Action Servers", ""),
        ("Action Clients", ""),
    )
)


def test_lines_of_nodes_that_cannot_be_read_are_named(tmp_path):
    cases = {
        "Unable to find node '/gone'": (INFO + "Unable to find node '/gone'\n", 14),
        "ends early": (INFO[: INFO.index("  Action Clients")], 12),
        "next too early": (INFO[: INFO.index("  Action Clients")] + INFO, 12),
        "name": (INFO.replace("/chatter:", "/cha-tter:"), 5),
        "heading": (INFO.replace("Publishers", "Printers"), 4),
        "node": (INFO + "/two//slashes\n", 14),
    }
    for what, (text, line) in cases.items():
        found = recorded(tmp_path, text)
        assert line in [each.line for each in found.unread], (what, found.unread)
    whole = recorded(tmp_path, INFO)
    assert not whole.unread
    assert topics(whole.participants[0], Action.PUBLISH) == {"rt/chatter"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("\n\n", "is empty"),
        ("hello\n", "is not a trace of Cyclone DDS, a dump"),
        (b"\xff\xfe\x00", "is not a trace"),
        (
            "1795417423.769100 [0]     python: udp de-initialized\n",
            "no line is about a participant",
        ),
    ],
)
def test_other_files_are_refused(tmp_path, text, message):
    with pytest.raises(MalformedError, match=message):
        recorded(tmp_path, text)


def test_limits(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "MAX_ENDPOINTS", 10)
    with pytest.raises(MalformedError, match="more than 10 endpoints"):
        read_recordings([KITCHEN])
    monkeypatch.setattr(reading, "MAX_RECORDING", 1000)
    with pytest.raises(FileError, match="larger than 1000 bytes"):
        read_recordings([KITCHEN])


def test_names_that_were_not_seen_or_cannot_be_issued(tmp_path):
    with pytest.raises(UsageError, match="'/cok' was seen") as error:
        read_recordings([NODES], names={"/cok": "/kitchen/cook"})
    assert "'/cook'" in (error.value.hint or "")
    hidden = INFO.replace("/talker", "/_ros2cli_daemon_0")
    long = INFO.replace("/talker", f"/{'a' * 64}")
    found = recorded(tmp_path, hidden + long)
    assert not found.participants
    assert [re.sub(r"\d+", "N", each.reason) for each in found.left_out] == [
        "it is a hidden node, as tools are",
        "its name has more than N characters: name it with --name",
    ]
    assert recorded(tmp_path, long, names={f"/{'a' * 64}": "/a"}).participants[0].name == "/a"


def test_crafted_lines_take_no_more_time_than_others():
    # With ways to read them that grow with the square of their length, these took minutes.
    head = "1795417423.769100 [0] dq.builtin: "
    many = " QOS={" * 80_000
    for begin in (f"{head}SPDP ST0 1:2:3:1c1 NEW", f"{head}SEDP ST0 1:2:3:103 NEW"):
        with pytest.raises(MalformedError, match="the line is cut"):
            CycloneTrace().add(f"{begin}{many}")
    trace = CycloneTrace()
    trace.add(f"{head}SPDP ST0 1:2:3:1c1 NEW QOS={{{'user_data=1<' * 40_000}}}")
    assert [each.name for each in trace.participants()] == [""]


def test_thousands_of_nodes_in_one_participant_take_no_more_time_than_others():
    nodes = tuple(f"/n{number}" for number in range(10_000))  # squared, a minute
    points = [Endpoint(0, Action.SUBSCRIBE, f"rq{each}/get_parametersRequest") for each in nodes]
    assert len(proposing._rule(nodes, points)["nodes"]) == len(nodes)


def test_topics_below_two_nodes_are_given_to_the_first_of_them():
    points = [
        Endpoint(0, Action.PUBLISH, topic) for topic in ("rt/a/b/x", "rt/a/y", "rt/ab/q", "rt/a")
    ]
    first = proposal_of(*points, nodes=("/a", "/a/b")).text
    assert "node: /a\n        publish:\n          - /a/b/x\n          - /a/y\n" in first
    assert "    publish:\n      - rt/a\n      - rt/ab/q\n" in first
    second = proposal_of(*points, nodes=("/a/b", "/a")).text
    assert "node: /a/b\n        publish:\n          - /a/b/x\n" in second
    assert "node: /a\n        publish:\n          - /a/y\n" in second
