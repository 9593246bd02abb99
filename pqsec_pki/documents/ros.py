"""ROS 2 names as DDS topics, and the topics that a node needs to run.

ROS 2 names here are fully qualified: `/chatter`, `/ns/node`. UsageError, with the reason, for a
name that ROS 2 does not accept.
"""

import re
from collections.abc import Iterable
from typing import NamedTuple

from pqsec_pki.errors import UsageError

DISCOVERY = "ros_discovery_info"
"""The topic that announces a participant's nodes; every participant publishes and subscribes."""

MAX_NAME = 247
"""rmw: 255 minus the eight characters that the DDS form may add."""

_NODE_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",  # since Iron; sros2's sample policy lacks it, and Jazzy nodes exit
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
_NODE_TOPICS = ("/parameter_events", "/rosout")
_LIFECYCLE_SERVICES = (
    "change_state",
    "get_available_states",
    "get_available_transitions",
    "get_state",
    "get_transition_graph",
)
_PARAMETER_SERVICES = tuple(each for each in _NODE_SERVICES if each != "get_type_description")
ACTION_SERVICES = ("cancel_goal", "get_result", "send_goal")
ACTION_TOPICS = ("feedback", "status")

_WORDS = (("rt", "", ""), ("rq", "Request", "request of "), ("rr", "Reply", "reply of "))
"""Prefix and ending of a DDS topic, and the words before its ROS 2 name."""
_CLIENT_SIDE = {("request of ", each) for each in ACTION_SERVICES}
_SERVER_SIDE = {("reply of ", each) for each in ACTION_SERVICES} | {
    ("", each) for each in ACTION_TOPICS
}
_ACTION_SIDES = (
    ("action ", _CLIENT_SIDE | _SERVER_SIDE),
    ("requests of action ", _CLIENT_SIDE),
    ("replies, feedback and status of action ", _SERVER_SIDE),
)
"""The words before an action's name, and its topics: the words before each, and its last part."""
_OF_EVERY_NODE = {DISCOVERY, "rt/clock", *(f"rt{each}" for each in _NODE_TOPICS)}
_OF_A_NODE = re.compile(
    rf"/(?:{'|'.join((*_NODE_SERVICES, *_LIFECYCLE_SERVICES))})(?:Request|Reply)\Z"
    r"|/transition_event\Z"
)

# The rules of rmw_validate_full_topic_name, in its order.
_FAULTS = (
    (re.compile(r"\A(?!/)"), "it does not start with '/'"),
    (re.compile(r"/\Z"), "it ends with '/'"),
    (re.compile(r"[^A-Za-z0-9_/]"), "only letters, digits, '_' and '/' are allowed"),
    (re.compile(r"//"), "it has '//' in it"),
    (re.compile(r"/[0-9]"), "a part of it starts with a digit"),
    (re.compile(rf"\A.{{{MAX_NAME + 1}}}"), f"it is longer than {MAX_NAME} characters"),
)


class Endpoints(NamedTuple):
    """DDS topics to publish and to subscribe to."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]

    @classmethod
    def joined(cls, parts: "Iterable[Endpoints]") -> "Endpoints":
        """The topics of all these."""
        each = list(parts)
        return cls(
            publish=tuple(topic for part in each for topic in part.publish),
            subscribe=tuple(topic for part in each for topic in part.subscribe),
        )


def resolve(name: str, node: str) -> str:
    """The full name of `name` as the node `node`, a full name, resolves it.

    `/x` is a full name; `x` is in the node's namespace; `~/x` is private, below the node.
    """
    if name.startswith("/"):
        return _checked(name)
    if name == "~" or name.startswith("~/"):
        return _checked(f"{_checked(node)}{name[1:]}")
    namespace, _, _ = _checked(node).rpartition("/")
    return _checked(f"{namespace}/{name}")


def fault(name: str) -> str | None:
    """Why ROS 2 does not accept the full `name`; None if it does."""
    return next((reason for pattern, reason in _FAULTS if pattern.search(name)), None)


def topic(name: str) -> str:
    """The DDS topic of a ROS topic."""
    return f"rt{_checked(name)}"


def service_request(name: str) -> str:
    """The DDS topic on which clients send requests."""
    return f"rq{_checked(name)}Request"


def service_reply(name: str) -> str:
    """The DDS topic on which the server replies."""
    return f"rr{_checked(name)}Reply"


def service_server(name: str) -> Endpoints:
    """The topics of the node that offers the service."""
    return Endpoints(publish=(service_reply(name),), subscribe=(service_request(name),))


def service_client(name: str) -> Endpoints:
    """The topics of a node that calls the service."""
    return Endpoints(publish=(service_request(name),), subscribe=(service_reply(name),))


def action_server(name: str) -> Endpoints:
    """The topics of the node that offers the action."""
    requests, replies, topics = _action(name)
    return Endpoints(publish=(*replies, *topics), subscribe=requests)


def action_client(name: str) -> Endpoints:
    """The topics of a node that uses the action."""
    requests, replies, topics = _action(name)
    return Endpoints(publish=requests, subscribe=(*replies, *topics))


def topic_publisher(name: str) -> Endpoints:
    """The topics of a node that publishes the topic."""
    return Endpoints(publish=(topic(name),), subscribe=())


def topic_subscriber(name: str) -> Endpoints:
    """The topics of a node that subscribes to the topic."""
    return Endpoints(publish=(), subscribe=(topic(name),))


def parameter_client(node_name: str) -> Endpoints:
    """The topics of a node that reads and sets the parameters of the node `node_name`."""
    inside = [f"{_checked(node_name)}/{service}" for service in _PARAMETER_SERVICES]
    return Endpoints.joined(map(service_client, inside))


def lifecycle_node(node_name: str) -> Endpoints:
    """The topics that a managed (lifecycle) node needs besides `node_minimum`."""
    services = [f"{_checked(node_name)}/{service}" for service in _LIFECYCLE_SERVICES]
    event = topic_publisher(f"{node_name}/transition_event")
    return Endpoints.joined([*map(service_server, services), event])


def lifecycle_client(node_name: str) -> Endpoints:
    """The topics of a node that manages the lifecycle node `node_name`."""
    services = [f"{_checked(node_name)}/{service}" for service in _LIFECYCLE_SERVICES]
    event = topic_subscriber(f"{node_name}/transition_event")
    return Endpoints.joined([*map(service_client, services), event])


def simulated_time() -> Endpoints:
    """The topics of a node with `use_sim_time`."""
    return topic_subscriber("/clock")


def service_topics(name: str) -> tuple[str, ...]:
    """All DDS topics of a service."""
    return service_request(name), service_reply(name)


def action_topics(name: str) -> tuple[str, ...]:
    """All DDS topics of an action."""
    return tuple(topic for topics in _action(name) for topic in topics)


def node_minimum(node_name: str) -> Endpoints:
    """The topics that a Jazzy node needs to start; without any one of them it exits.

    Measured with rclpy 7.1 on Cyclone DDS. It needs no clients of its own services, and `/clock`
    only if it uses simulated time.
    """
    services = [f"{_checked(node_name)}/{service}" for service in _NODE_SERVICES]
    return Endpoints(
        publish=(DISCOVERY, *map(topic, _NODE_TOPICS), *map(service_reply, services)),
        subscribe=(DISCOVERY, *map(service_request, services)),
    )


def said(topic: str) -> str:
    """A DDS topic in the words of ROS 2, such as `request of /reset`; as it is if it has none."""
    return "".join(_in_words(topic)) or topic


def action_sides(topics: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """The actions of which `topics` has all that a client, a server or both publish.

    Gives the words for each, such as `requests of action /dock`, and its topics. It undoes
    `action_client` and `action_server`, for any name in place of the action's.
    """
    found: dict[str, dict[tuple[str, str], str]] = {}
    for each in topics:
        words, name = _in_words(each)
        action, inside, part = name.rpartition("/_action/")
        if inside:
            found.setdefault(action, {})[words, part] = each
    sides = {}
    for action, parts in found.items():
        for words, side in _ACTION_SIDES:
            if side <= parts.keys():
                sides[f"{words}{action}"] = tuple(parts.pop(each) for each in sorted(side))
    return sides


def is_of_every_node(topic: str) -> bool:
    """Whether ROS 2 itself uses the DDS topic in every node or lifecycle node."""
    return topic in _OF_EVERY_NODE or _OF_A_NODE.search(topic) is not None


def is_ros_name(topic: str) -> bool:
    """Whether a DDS topic has the form of a ROS 2 topic, `/x`: ROS 2 nodes use `rt/x`."""
    return topic.startswith("/") and fault(topic) is None


def doubled_slash(topic: str) -> bool:
    """Whether a DDS topic has the prefix of ROS 2 and `//`, which no ROS 2 topic has."""
    return topic.startswith(("rt/", "rq/", "rr/")) and "//" in topic


def _in_words(topic: str) -> tuple[str, str]:
    """The words before the ROS 2 name of a DDS topic, and the name; both empty if it has none."""
    kind, slash, name = topic.partition("/")
    for prefix, ending, words in _WORDS:
        if slash and kind == prefix and name.endswith(ending):
            return words, f"/{name.removesuffix(ending)}"
    return "", ""


def _action(name: str) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    inside = f"{_checked(name)}/_action/"
    services = [inside + service for service in ACTION_SERVICES]
    return (
        tuple(map(service_request, services)),
        tuple(map(service_reply, services)),
        tuple(topic(inside + part) for part in ACTION_TOPICS),
    )


def _checked(name: str) -> str:
    if reason := fault(name):
        full = f"/{name}"
        example = "/chatter" if fault(full) else full
        raise UsageError(
            f"{name!r} is not a full ROS 2 name: {reason}", hint=f"write a full name, as {example}"
        )
    return name
