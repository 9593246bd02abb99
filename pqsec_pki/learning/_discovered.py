"""A participant as its discovery shows it, in whatever form that was recorded."""

import re
from dataclasses import field

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Action
from pqsec_pki.documents import MAX_DOMAIN, ros
from pqsec_pki.errors import MalformedError, UsageError
from pqsec_pki.learning.seen import Endpoint, SeenParticipant

ACTIONS = {
    0x02: Action.PUBLISH,
    0x03: Action.PUBLISH,
    0x04: Action.SUBSCRIBE,
    0x07: Action.SUBSCRIBE,
}
"""Kind of entity -> action (RTPS 2.5, table 9.1). Others are built in, or topics."""
_ENCLAVE = re.compile(r"(?:\A|;)enclave=([^;]*);")
_NODE = re.compile(r"rq(/.+)/get_parametersRequest")
"""The service that shows a node; nodes can be without it."""


@dataclass(slots=True)
class DiscoveredParticipant:
    """What is known of a participant so far."""

    enclave: str = ""
    label: str = ""
    endpoints: dict[Endpoint, None] = field(default_factory=dict)

    def seen(self) -> SeenParticipant:
        """The participant with its name: its enclave, else its first node."""
        nodes = tuple(dict.fromkeys(filter(None, map(_node, self.endpoints))))
        unnamed = self.enclave in {"", "/"}  # `/` is the enclave of nodes that were given none
        return SeenParticipant(
            name=(nodes[0] if nodes else "") if unnamed else self.enclave,
            label=self.label,
            nodes=nodes,
            endpoints=frozenset(self.endpoints),
        )


def endpoint(domain: int, action: Action, topic: str, partitions: list[str]) -> Endpoint:
    """A writer or reader. A partition without a name is the default one (DDS 1.4, 2.2.3.13)."""
    return Endpoint(domain, action, topic, tuple(sorted({*partitions})) if any(partitions) else ())


def enclave_in(user_data: str) -> str | None:
    """The enclave that ROS 2 writes into user data; "" if there is none, None if its end is not."""
    found = _ENCLAVE.search(user_data)
    if found is None and "enclave=" in user_data:
        return None
    return found[1] if found else ""


def domain_in(text: str) -> int:
    """The number of a domain."""
    decimal = text.isascii() and text.isdecimal() and len(text) <= len(str(MAX_DOMAIN))
    if not decimal or int(text) > MAX_DOMAIN:
        raise MalformedError(f"'{text[:20]}' is not a domain from 0 to {MAX_DOMAIN}")
    return int(text)


def is_node(name: str) -> bool:
    """Whether a node of ROS 2 can have this full name."""
    try:
        ros.node_minimum(name)
    except UsageError:
        return False
    return True


def _node(endpoint: Endpoint) -> str:
    """The node that an endpoint shows; empty for nearly all endpoints."""
    found = _NODE.fullmatch(endpoint.topic)
    shown = found and endpoint.action is Action.SUBSCRIBE and is_node(found[1])
    return found[1] if found and shown else ""
