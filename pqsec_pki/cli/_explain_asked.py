"""What explain is asked: one right, named by topics of DDS or in the words of ROS 2."""

from collections.abc import Callable
from typing import Any

import click

from pqsec_pki.access import Action
from pqsec_pki.cli import _completion, _ros_patterns, _settings
from pqsec_pki.documents import ros
from pqsec_pki.errors import UsageError
from pqsec_pki.policy import NamedRight


def _client(server: Callable[[str], ros.Endpoints]) -> Callable[[str], ros.Endpoints]:
    return lambda name: _ros_patterns.opposite(server(name))


def _both_sides(topics: tuple[str, ...]) -> ros.Endpoints:
    return ros.Endpoints(publish=topics, subscribe=topics)


_ROS: dict[str, tuple[str, Callable[[str], ros.Endpoints]]] = {
    "ros_topic": (
        "publish and subscribe to",
        lambda name: _both_sides((_ros_patterns.topic(name),)),
    ),
    "ros_service": ("serve the service", _ros_patterns.service_server),
    "ros_client": ("call the service", _client(_ros_patterns.service_server)),
    "ros_action_server": ("serve the action", _ros_patterns.action_server),
    "ros_action_client": ("use the action", _client(_ros_patterns.action_server)),
    "ros_action": (
        "serve and use the action",
        lambda name: _both_sides(_ros_patterns.both(_ros_patterns.action_server(name))),
    ),
    "ros_node": ("run as the node", ros.node_minimum),
    "ros_parameters": ("read and set the parameters of", ros.parameter_client),
}
"""Option -> words, and what its endpoints need; the options but the last are as in `issue`."""
_TOPICS = {
    f"{prefix}{action}": (action, convert)
    for action in (Action.PUBLISH, Action.SUBSCRIBE, Action.RELAY)
    for prefix, convert in (("", str), ("ros_", _ros_patterns.topic))
    if (prefix, action) != ("ros_", Action.RELAY)
}

_HELP = {
    "publish": "publish this DDS topic, or those that a pattern matches",
    "subscribe": "subscribe to this DDS topic or pattern",
    "relay": "relay this DDS topic or pattern",
    "ros_publish": "publish this ROS 2 topic or pattern",
    "ros_subscribe": "subscribe to this ROS 2 topic or pattern",
    "ros_topic": "publish and subscribe to this ROS 2 topic or pattern",
    "ros_service": "serve this ROS 2 service or pattern",
    "ros_client": "call this ROS 2 service or pattern",
    "ros_action_server": "serve this ROS 2 action or pattern",
    "ros_action_client": "use this ROS 2 action or pattern",
    "ros_action": "serve and use this ROS 2 action or pattern",
    "ros_node": "run as this ROS 2 node",
    "ros_parameters": "read and set the parameters of this ROS 2 node",
}
"""Option -> what it asks."""


def options(command: _settings.Command) -> _settings.Command:
    """Add an option for each right."""
    command = click.option("--join", is_flag=True, help="Ask whether it may join the domain.")(
        command
    )
    for key, words in reversed(_HELP.items()):
        complete = _completion.ros_topics if key.startswith("ros_") else _completion.topics
        is_topic = key in _TOPICS or key == "ros_topic"
        command = click.option(
            f"--{key.replace('_', '-')}",
            metavar="TOPIC" if is_topic else "NODE" if key in _NODES else "NAME",
            help=f"Ask whether it may {words}.",
            shell_complete=complete if is_topic else None,
        )(command)
    return command


_NODES = {"ros_node", "ros_parameters"}


def right_asked(given: dict[str, Any]) -> NamedRight:
    """The right that the options name. UsageError unless there is exactly one."""
    asked = [key for key in (*_HELP, "join") if given[key]]
    if len(asked) != 1:
        raise UsageError(
            "ask exactly one question",
            hint="use --publish TOPIC, --subscribe TOPIC, --relay TOPIC, --ros-publish TOPIC,"
            " --ros-subscribe TOPIC, --ros-service NAME, ... or --join",
        )
    [key] = asked
    if key == "join":
        return NamedRight("join", ((Action.JOIN, None),))
    name = given[key]
    if key in _TOPICS:
        action, convert = _TOPICS[key]
        return NamedRight(f"{action} {name}", ((action, convert(name)),))
    words, needed = _ROS[key]
    uses = needed(name)
    return NamedRight(
        f"{words} {name}",
        (
            *((Action.PUBLISH, topic) for topic in uses.publish),
            *((Action.SUBSCRIBE, topic) for topic in uses.subscribe),
        ),
    )
