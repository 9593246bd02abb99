"""DDS topics of a ROS 2 node in the words that `_nodes_yaml` reads."""

import re
from collections.abc import Iterator
from itertools import chain

from pqsec_pki.documents import ros
from pqsec_pki.documents._nodes_yaml import USES
from pqsec_pki.documents.ros import Endpoints
from pqsec_pki.errors import UsageError

_SERVICE = r"r[qr](/.+)(?:Request|Reply)"
_TOPIC = r"rt(/.+)"
_NAMES = {
    "parameters_of": r"r[qr](/.+)/get_parameters(?:Request|Reply)",
    "lifecycle_of": r"r[qr](/.+)/change_state(?:Request|Reply)",
    "action_servers": r"r[qr](/.+)/_action/send_goal(?:Request|Reply)",
    "action_clients": r"r[qr](/.+)/_action/send_goal(?:Request|Reply)",
    "services": _SERVICE,
    "clients": _SERVICE,
    "publish": _TOPIC,
    "subscribe": _TOPIC,
}
"""Key -> pattern of a topic that contains its name. Keys with many topics come before their
parts."""


_Right = tuple[str, str]
"""`publish` or `subscribe`, and a DDS topic."""


def node_as_yaml(node: str, topics: Endpoints) -> tuple[object, Endpoints]:
    """An item of `nodes` for the full name `node`, and those of `topics` that it does not give.

    It gives nothing besides `topics` but what every node needs to start: a service or an action
    is named if all its topics are there. UsageError for a name that ROS 2 does not accept.
    """
    left = {*_rights(topics)}
    left -= {*_rights(ros.node_minimum(node))}
    words: dict[str, object] = {"node": node}
    flags = {"lifecycle": ros.lifecycle_node(node), "use_sim_time": ros.simulated_time()}
    for flag, of_all in flags.items():
        of_flag = {*_rights(of_all)}
        if of_flag <= left:
            words[flag] = True
            left -= of_flag
    for key, pattern in _NAMES.items():
        names = {found[1] for _, topic in left if (found := re.fullmatch(pattern, topic))}
        for name in sorted(names):
            used = _used(key, name)
            if used and used <= left:
                words.setdefault(key, []).append(name)  # type: ignore[attr-defined] # a list
                left -= used
    item = words if len(words) > 1 else node
    return item, Endpoints(
        publish=tuple(sorted(topic for way, topic in left if way == "publish")),
        subscribe=tuple(sorted(topic for way, topic in left if way == "subscribe")),
    )


def _used(key: str, name: str) -> set[_Right]:
    try:
        return {*_rights(USES[key](name))}
    except UsageError:  # not a name of ROS 2
        return set()


def _rights(topics: Endpoints) -> Iterator[_Right]:
    return chain(
        (("publish", topic) for topic in topics.publish),
        (("subscribe", topic) for topic in topics.subscribe),
    )
