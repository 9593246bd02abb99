"""What `pqsec permit --remove` says: what rights that it does not find may have meant, until when
the permissions that were signed before still work, and how to end them now."""

import shlex
from collections.abc import Collection, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.access import Action, TopicRights, granted_topics
from pqsec_pki.cli import _printing
from pqsec_pki.cli._participant_options import SINGLE_TOPICS, topics_of
from pqsec_pki.documents import Grant, ros
from pqsec_pki.errors import meant
from pqsec_pki.keystore import ListDelivery

_DOING = {Action.PUBLISH: "publishing", Action.SUBSCRIBE: "subscribing to"}


@dataclass(frozen=True, slots=True)
class Removal:
    """What a removal of rights does not end."""

    keystore: Path
    earlier: Mapping[str, datetime]
    """Until when documents that were signed before can be used, by participant."""
    delivery: ListDelivery | None

    def to_json(self) -> dict[str, object]:
        """It for --json."""
        return {
            "earlier": [{"name": name, "until": end} for name, end in self.earlier.items()],
            "commands": self.commands if self.earlier else (),
            "delivery": self.delivery,
        }

    @property
    def commands(self) -> tuple[str, str]:
        """The two commands that each end the earlier documents now."""
        keystore = f"pqsec -k {shlex.quote(str(self.keystore))}"
        names = " ".join(map(shlex.quote, self.earlier))
        return (
            f"{keystore} revoke {names} --reason privilegeWithdrawn --yes",
            f"{keystore} ca rotate --only permissions --apply --yes",
        )

    @property
    def lines(self) -> Iterator[str]:
        """It for people."""
        if self.earlier:
            names, until = _printing.few(self.earlier), said(max(self.earlier.values()))
            revoke, rotate = self.commands
            yield (
                f"the permissions that were signed before stay valid until {until}, if somebody"
                f" puts that permissions.p7s back on the robot of {names}"
            )
            yield (
                "to end them now, revoke it, and issue it under another name, which they do not"
                f" have: {revoke}"
            )
            yield f"or replace the permissions CA, and copy its files to every robot: {rotate}"
        if self.delivery:
            yield from self.delivery.lines


def note_not_granted(given: dict[str, Any], grants: Collection[Grant]) -> None:
    """Note what topics that are to be removed, and no rule allows, may have meant.

    `given` are the options for topics. Those for all topics of a node or an action are left out.
    """
    publish, subscribe = topics_of(**{each: given[each] for each in SINGLE_TOPICS})
    for action, topic in TopicRights(publish=publish, subscribe=subscribe):
        allowed = any(granted_topics(each, action, topic) for each in grants)
        if not allowed and (instead := _instead(action, topic, grants)):
            _printing.note(f"no rule allows {_DOING[action]} {topic}; {instead}")


def _instead(action: Action, topic: str, grants: Collection[Grant]) -> str:
    """The right that a topic may have meant: the one of ROS 2, or the other direction; or ''."""
    name = ros.topic(topic) if ros.is_ros_name(topic) else topic
    if name != topic and any(granted_topics(each, action, name) for each in grants):
        return f"ROS 2 nodes use {name}: --ros-{action} {topic}"
    other = Action.SUBSCRIBE if action is Action.PUBLISH else Action.PUBLISH
    if any(granted_topics(each, other, name) for each in grants):
        return f"one allows {_DOING[other]} {name}"
    return meant(topic, [each for grant in grants for each in granted_topics(grant, action)])
