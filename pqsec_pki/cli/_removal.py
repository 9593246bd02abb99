"""What rights that `pqsec permit --remove` does not find may have meant."""

from collections.abc import Collection
from typing import Any

from pqsec_pki.access import Action, TopicRights, granted_topics
from pqsec_pki.cli import _printing
from pqsec_pki.cli._participant_options import SINGLE_TOPICS, topics_of
from pqsec_pki.documents import Grant, ros
from pqsec_pki.errors import meant

_DOING = {Action.PUBLISH: "publishing", Action.SUBSCRIBE: "subscribing to"}


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
