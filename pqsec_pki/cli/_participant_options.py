"""Options for the rights of participants, shared by commands that issue or request."""

from collections.abc import Collection, Iterable
from datetime import timedelta
from pathlib import Path
from typing import Any, Self

import click

from pqsec_pki import policy
from pqsec_pki._dataclass import dataclass
from pqsec_pki.cli import _completion, _policy, _printing, _settings
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec

_ROS = {
    "ros_node": ros.node_minimum,
    "ros_service": ros.service_server,
    "ros_client": ros.service_client,
    "ros_action_server": ros.action_server,
    "ros_action_client": ros.action_client,
}
"""Option -> function that returns the topics to publish and subscribe."""

SINGLE_TOPICS = ("publish", "subscribe", "ros_publish", "ros_subscribe")
"""The names of the options for one topic each, as parameters."""

TOPIC_NAMES = (*SINGLE_TOPICS, *_ROS)
"""The names of all options for topics, as parameters."""

_TOPICS = (
    click.option(
        "--publish",
        multiple=True,
        metavar="TOPIC",
        help="Allow to publish this DDS topic.",
        shell_complete=_completion.topics,
    ),
    click.option(
        "--subscribe",
        multiple=True,
        metavar="TOPIC",
        help="Allow to subscribe to this DDS topic.",
        shell_complete=_completion.topics,
    ),
    click.option(
        "--ros-publish",
        multiple=True,
        metavar="TOPIC",
        help="Allow to publish this ROS 2 topic.",
        shell_complete=_completion.ros_topics,
    ),
    click.option(
        "--ros-subscribe",
        multiple=True,
        metavar="TOPIC",
        help="Allow to subscribe to this ROS 2 topic.",
        shell_complete=_completion.ros_topics,
    ),
    click.option(
        "--ros-service", multiple=True, metavar="NAME", help="Allow to serve this ROS 2 service."
    ),
    click.option(
        "--ros-client", multiple=True, metavar="NAME", help="Allow to call this ROS 2 service."
    ),
    click.option(
        "--ros-action-server",
        multiple=True,
        metavar="NAME",
        help="Allow to serve this ROS 2 action.",
    ),
    click.option(
        "--ros-action-client",
        multiple=True,
        metavar="NAME",
        help="Allow to call this ROS 2 action.",
    ),
    click.option(
        "--ros-node",
        multiple=True,
        metavar="NODE",
        help="Allow the topics that this ROS 2 node needs to start.",
    ),
)

_OPTIONS = (
    *_TOPICS,
    click.option(
        "--policy",
        type=_settings.FILE,
        help="Take the rights of each NAME from permissions in YAML or an SROS2 policy.",
    ),
    click.option(
        "--validity",
        type=_settings.Duration(),
        default="1y",
        show_default=True,
        help="Issue for this long: 1y, 26w, 90d or 12h.",
    ),
)


def participant_options(command: _settings.Command) -> _settings.Command:
    """Add the options; their values are the keyword arguments of ParticipantOptions.of."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def topic_options(command: _settings.Command) -> _settings.Command:
    """Add the options for topics; their values are the keyword arguments of `topics_of`."""
    for option in reversed(_TOPICS):
        command = option(command)
    return command


def topics_of(
    *,
    publish: tuple[str, ...],
    subscribe: tuple[str, ...],
    ros_publish: tuple[str, ...],
    ros_subscribe: tuple[str, ...],
    **ros_names: Any,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The DDS topics to publish and to subscribe to, each once. UsageError for a ROS name."""
    publish += tuple(map(ros.topic, ros_publish))
    subscribe += tuple(map(ros.topic, ros_subscribe))
    for option, given in ros_names.items():
        for name in given:
            also = _ROS[option](name)
            publish, subscribe = publish + also.publish, subscribe + also.subscribe
    return tuple(dict.fromkeys(publish)), tuple(dict.fromkeys(subscribe))


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantOptions:
    """The rights of each named participant."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]
    policy: Path | None
    validity: timedelta

    @classmethod
    def of(cls, *, policy: Path | None, validity: timedelta, **topics: Any) -> Self:
        """Values of the options. UsageError for an invalid ROS name, or topics and --policy."""
        note_ros_names(topics["publish"], topics["subscribe"])
        publish, subscribe = topics_of(**topics)
        if policy and (publish or subscribe):
            raise UsageError("--policy and topics exclude each other")
        return cls(publish=publish, subscribe=subscribe, policy=policy, validity=validity)

    @property
    def policy_names(self) -> tuple[str, ...]:
        """The names that the policy has grants for, in its order; empty without a policy."""
        return _policy.names_in(self.policy, now=_settings.now()) if self.policy else ()

    def specs(self, names: tuple[str, ...], domains: DomainSet) -> list[ParticipantSpec]:
        """One spec for each name. UsageError for a name without a grant in the policy."""
        specs = [
            ParticipantSpec(
                name=name,
                domains=domains,
                publish=self.publish,
                subscribe=self.subscribe,
                validity=self.validity,
            )
            for name in names
        ]
        if self.policy:
            specs = _policy.with_grants(specs, self.policy, now=_settings.now())
        return specs


def note_doubtful_topics(keystore: Keystore, names: Collection[str]) -> None:
    """Note in one line which topics of participants look like mistakes, if any do."""
    found = list(policy.doubtful_topics(keystore, names, _settings.now())) if names else ()
    if found:
        more = f"; and {len(found) - 1} more, see `pqsec check`" if len(found) > 1 else ""
        _printing.note(f"{found[0]}{more}")


def note_ros_names(publish: Iterable[str], subscribe: Iterable[str]) -> None:
    """Note DDS topics that have the form of a ROS 2 name: ROS 2 nodes do not use them."""
    for option, topics in (("publish", publish), ("subscribe", subscribe)):
        for topic in filter(ros.is_ros_name, topics):
            _printing.note(
                f"{topic} is a DDS topic here, and ROS 2 nodes use {ros.topic(topic)}: for that,"
                f" use --ros-{option} {topic}"
            )
