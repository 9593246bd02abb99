"""ROS 2 names and patterns in questions, as DDS topics and patterns of topics."""

import re

from pqsec_pki.documents import ros

_PATTERN = re.compile(r"[*?\[]")


def topic(name: str) -> str:
    """The DDS topic of a ROS 2 topic. UsageError for what is neither a name nor a pattern."""
    return f"rt{name}" if _is_pattern(name) else ros.topic(name)


def service_server(name: str) -> ros.Endpoints:
    """What the server of a service uses; its clients publish and subscribe to the opposite."""
    if _is_pattern(name):
        return ros.Endpoints(publish=(f"rr{name}Reply",), subscribe=(f"rq{name}Request",))
    return ros.service_server(name)


def action_server(name: str) -> ros.Endpoints:
    """What the server of an action uses; its clients publish and subscribe to the opposite."""
    if _is_pattern(name):
        inside = f"{name}/_action/*"
        return ros.Endpoints(publish=(f"rr{inside}", f"rt{inside}"), subscribe=(f"rq{inside}",))
    return ros.action_server(name)


def opposite(endpoints: ros.Endpoints) -> ros.Endpoints:
    """What the other side uses."""
    return ros.Endpoints(publish=endpoints.subscribe, subscribe=endpoints.publish)


def both(endpoints: ros.Endpoints) -> tuple[str, ...]:
    """All topics, requests first."""
    return (*endpoints.subscribe, *endpoints.publish)


def _is_pattern(name: str) -> bool:
    return name.startswith("/") and bool(_PATTERN.search(name))
