"""What participants shall be allowed: the options of commands that issue, or ask to."""

from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, Self

import click

from pqsec_pki.cli import _policy, _settings
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import ParticipantSpec

_ROS = {
    "ros_node": ros.node_minimum,
    "ros_service": ros.service_server,
    "ros_client": ros.service_client,
    "ros_action_server": ros.action_server,
    "ros_action_client": ros.action_client,
}
"""Option -> what it lets a participant publish and subscribe to."""

_OPTIONS = (
    click.option("--publish", multiple=True, metavar="TOPIC", help="A DDS topic expression."),
    click.option("--subscribe", multiple=True, metavar="TOPIC", help="A DDS topic expression."),
    click.option("--ros-publish", multiple=True, metavar="TOPIC", help="A ROS 2 topic: /chatter."),
    click.option("--ros-subscribe", multiple=True, metavar="TOPIC", help="A ROS 2 topic."),
    click.option("--ros-service", multiple=True, metavar="NAME", help="A ROS 2 service it serves."),
    click.option("--ros-client", multiple=True, metavar="NAME", help="A ROS 2 service it calls."),
    click.option("--ros-action-server", multiple=True, metavar="NAME", help="An action it serves."),
    click.option("--ros-action-client", multiple=True, metavar="NAME", help="An action it calls."),
    click.option(
        "--ros-node",
        multiple=True,
        metavar="NODE",
        help="What a ROS 2 node needs to start: /talker.",
    ),
    click.option(
        "--policy",
        type=_settings.FILE,
        help="Take what each NAME may do from permissions in YAML, or a policy of SROS2.",
    ),
    click.option("--validity", type=_settings.Duration(), default="1y", show_default=True),
)


def participant_options(command: _settings.Command) -> _settings.Command:
    """Add the options; what they say arrives as keywords, for Wanted.of."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantOptions:
    """What each participant that is named shall be allowed."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]
    policy: Path | None
    validity: timedelta

    @classmethod
    def of(  # noqa: PLR0913 -- one for each option, by name
        cls,
        *,
        publish: tuple[str, ...],
        subscribe: tuple[str, ...],
        ros_publish: tuple[str, ...],
        ros_subscribe: tuple[str, ...],
        policy: Path | None,
        validity: timedelta,
        **ros_names: Any,
    ) -> Self:
        """From the options; UsageError for what is not a ROS name, or topics beside a policy."""
        publish += tuple(map(ros.topic, ros_publish))
        subscribe += tuple(map(ros.topic, ros_subscribe))
        for option, given in ros_names.items():
            for name in given:
                also = _ROS[option](name)
                publish, subscribe = publish + also.publish, subscribe + also.subscribe
        if policy and (publish or subscribe):
            raise UsageError("--policy says which topics there are: name none beside it")
        return cls(
            publish=tuple(dict.fromkeys(publish)),
            subscribe=tuple(dict.fromkeys(subscribe)),
            policy=policy,
            validity=validity,
        )

    @property
    def everybody(self) -> tuple[str, ...]:
        """Whom the policy has grants for, in its order; nobody without one."""
        return _policy.names_in(self.policy, now=_settings.now()) if self.policy else ()

    def specs(self, names: tuple[str, ...], domains: DomainSet) -> list[ParticipantSpec]:
        """One for each name; UsageError for a name that the policy does not have."""
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
            specs = _policy.granted(specs, self.policy, now=_settings.now())
        return specs
