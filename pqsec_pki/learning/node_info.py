"""Reads the output of `ros2 node info`, of one node or several, as ROS 2 Foxy to Rolling write it.

    /talker
      Subscribers:

      Publishers:
        /chatter: std_msgs/msg/String
      Service Servers:
      ...

It does not show enclaves, partitions, or the topics of DDS that are not of ROS 2.
"""

import re
from collections.abc import Callable
from dataclasses import field

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Action
from pqsec_pki.documents import ros
from pqsec_pki.errors import MalformedError, shown
from pqsec_pki.learning._discovered import is_node
from pqsec_pki.learning.seen import Endpoint, SeenParticipant

IS_NODE = re.compile(r"(/\S+)")
_HEADING = re.compile(r"  (\S.*):")
_USE = re.compile(r"    (/\S*): \S.*")
_HEADINGS: dict[str, Callable[[str], ros.Endpoints]] = {
    "Subscribers": ros.topic_subscriber,
    "Publishers": ros.topic_publisher,
    "Service Servers": ros.service_server,
    "Service Clients": ros.service_client,
    "Action Servers": ros.action_server,
    "Action Clients": ros.action_client,
}
"""In the order of the output."""
_LAST = list(_HEADINGS)[-1]


@dataclass(slots=True)
class NodeInfo:
    """The nodes that the lines so far show; each is taken as one participant."""

    domain: int
    """The domain that `ros2` was in; its output does not have it."""
    _found: dict[str, set[Endpoint]] = field(default_factory=dict)
    _node: str = ""
    _heading: str = _LAST

    def add(self, line: str) -> None:
        """Read one line. MalformedError, with the reason, if it cannot be read."""
        if not line.strip():
            return
        if found := IS_NODE.fullmatch(line):
            self._begin(found[1])
        elif (found := _HEADING.fullmatch(line)) and self._node and found[1] in _HEADINGS:
            self._heading = found[1]
        elif (found := _USE.fullmatch(line)) and self._node and self._heading:
            self._use(found[1])
        else:
            raise MalformedError("not a line of `ros2 node info`")

    def _begin(self, name: str) -> None:
        reason, self._node = self.unfinished, ""
        if not is_node(name):
            raise MalformedError(f"'{shown(name)}' is not the full name of a node")
        self._node, self._heading = name, ""
        self._found.setdefault(name, set())
        if reason:
            raise MalformedError(reason)

    def _use(self, name: str) -> None:
        if reason := ros.fault(name):
            raise MalformedError(f"'{shown(name)}' is not a full ROS 2 name: {reason}")
        topics = _HEADINGS[self._heading](name)
        ways = ((Action.PUBLISH, topics.publish), (Action.SUBSCRIBE, topics.subscribe))
        self._found[self._node] |= {
            Endpoint(self.domain, action, topic) for action, names in ways for topic in names
        }

    @property
    def unfinished(self) -> str:
        """Why the lines about the last node are not complete; empty if they are."""
        complete = not self._node or self._heading == _LAST
        return "" if complete else f"the lines about {self._node} end without '{_LAST}:'"

    def participants(self) -> list[SeenParticipant]:
        """One for each node, in the order of the lines."""
        return [
            SeenParticipant(name=name, nodes=(name,), endpoints=frozenset(endpoints))
            for name, endpoints in self._found.items()
        ]
