"""ROS 2 names in their DDS form."""

import pytest

from pqsec_pki.documents import ros
from pqsec_pki.errors import UsageError

# As SROS2 writes them for the same policy: tests/vectors/corpus/sros2/test/policies.
FIBONACCI_REQUESTS = {
    "rq/fibonacci/_action/cancel_goalRequest",
    "rq/fibonacci/_action/get_resultRequest",
    "rq/fibonacci/_action/send_goalRequest",
}
FIBONACCI_REPLIES = {
    "rr/fibonacci/_action/cancel_goalReply",
    "rr/fibonacci/_action/get_resultReply",
    "rr/fibonacci/_action/send_goalReply",
}
FIBONACCI_TOPICS = {"rt/fibonacci/_action/feedback", "rt/fibonacci/_action/status"}


def test_a_topic_is_prefixed():
    assert ros.topic("/ns/chatter") == "rt/ns/chatter"


def test_a_service_is_a_request_topic_and_a_reply_topic():
    assert ros.service_server("/add") == (("rr/addReply",), ("rq/addRequest",))
    assert ros.service_client("/add") == (("rq/addRequest",), ("rr/addReply",))


def test_the_topics_of_an_action_are_told_as_one():
    client, server = ros.action_client("/fibonacci"), ros.action_server("/fibonacci")
    others = ("rt/chatter", "rq/fibonacci/_action/otherRequest", "/fibonacci/_action/status")
    replies = "replies, feedback and status of action /fibonacci"
    requested = ros.action_sides([*others, *client.publish])
    assert {words: set(each) for words, each in requested.items()} == {
        "requests of action /fibonacci": set(client.publish)
    }
    assert {words: set(each) for words, each in ros.action_sides(server.publish).items()} == {
        replies: set(server.publish)
    }
    both = [*client.publish, *client.subscribe]
    assert {words: set(each) for words, each in ros.action_sides(both).items()} == {
        "action /fibonacci": set(both)
    }
    # What is not whole is not told as an action: a right to a part of it must be seen.
    assert ros.action_sides(client.publish[1:]) == {}
    partly = ros.action_sides([*client.publish[1:], *server.publish])
    assert list(partly) == [replies]
    template = [each.replace("/fibonacci", "/{name}/*") for each in client.publish]
    assert list(ros.action_sides(template)) == ["requests of action /{name}/*"]


def test_an_action_is_three_services_and_two_topics():
    server, client = ros.action_server("/fibonacci"), ros.action_client("/fibonacci")
    assert set(server.publish) == FIBONACCI_REPLIES | FIBONACCI_TOPICS
    assert set(server.subscribe) == FIBONACCI_REQUESTS
    assert set(client.publish) == FIBONACCI_REQUESTS
    assert set(client.subscribe) == FIBONACCI_REPLIES | FIBONACCI_TOPICS


def test_the_minimum_of_a_jazzy_node_is_what_was_measured():
    publish, subscribe = ros.node_minimum("/ns/talker")
    services = (
        "describe_parameters",
        "get_parameter_types",
        "get_parameters",
        "get_type_description",
        "list_parameters",
        "set_parameters",
        "set_parameters_atomically",
    )
    assert set(publish) == {
        "ros_discovery_info",
        "rt/parameter_events",
        "rt/rosout",
        *(f"rr/ns/talker/{service}Reply" for service in services),
    }
    assert set(subscribe) == {
        "ros_discovery_info",
        *(f"rq/ns/talker/{service}Request" for service in services),
    }


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("", "does not start with '/'"),
        ("chatter", "does not start with '/'"),
        ("~/chatter", "does not start with '/'"),
        ("/", "ends with '/'"),
        ("/chatter/", "ends with '/'"),
        ("/a//b", "has '//'"),
        ("/a/2b", "starts with a digit"),
        ("/chat-ter", "only letters"),
        ("/chatter*", "only letters"),
        ("/café", "only letters"),
        ("/chatter\n", "only letters"),
        ("/{node}", "only letters"),
        ("/" + "a" * 247, "longer than 247"),
    ],
)
@pytest.mark.parametrize(
    "use",
    [ros.topic, ros.service_server, ros.service_client, ros.action_server, ros.node_minimum],
)
def test_a_name_ros_2_would_not_take_is_refused_with_the_reason(use, name, reason):
    with pytest.raises(UsageError, match=reason):
        use(name)


@pytest.mark.parametrize("name", ["/a", "/_hidden", "/a__b", "/a_/b2", "/" + "a" * 246])
def test_a_name_ros_2_takes_is_taken(name):
    assert ros.topic(name) == f"rt{name}"
