"""What the elements of an SROS2 policy allow, as in SROS2's own templates.

SROS2 accepts patterns as names, so names are not checked here, unlike in `ros`.
"""

from collections.abc import Callable

from pqsec_pki.documents.ros import ACTION_SERVICES, ACTION_TOPICS, Endpoints


def _request_side(name: str) -> Endpoints:
    return Endpoints((f"rq{name}Request",), (f"rr{name}Reply",))


def _call(name: str) -> Endpoints:
    inside = [f"{name}/_action/{service}" for service in ACTION_SERVICES]
    topics = tuple(f"rt{name}/_action/{topic}" for topic in ACTION_TOPICS)
    replies = tuple(f"rr{each}Reply" for each in inside)
    return Endpoints(tuple(f"rq{each}Request" for each in inside), (*replies, *topics))


def _reversed(topics: Endpoints) -> Endpoints:
    return Endpoints(topics.subscribe, topics.publish)


KINDS: dict[str, tuple[str, dict[str, Callable[[str], Endpoints]]]] = {
    "topics": (
        "topic",
        {
            "publish": lambda name: Endpoints((f"rt{name}",), ()),
            "subscribe": lambda name: Endpoints((), (f"rt{name}",)),
        },
    ),
    "services": (
        "service",
        {"request": _request_side, "reply": lambda name: _reversed(_request_side(name))},
    ),
    "actions": (
        "action",
        {"call": _call, "execute": lambda name: _reversed(_call(name))},
    ),
}
"""Element -> (element of its names, attribute -> DDS topics that it allows for a name)."""

TYPES = {
    **{
        name: name.capitalize() for name in ("policy", "enclaves", "enclave", "profiles", "profile")
    },
    "topics": "TopicExpressionList",
    "services": "ServicesExpressionList",
    "actions": "ActionsExpressionList",
    **dict.fromkeys(("topic", "service", "action"), "Expression"),
}
"""Element -> its type in SROS2's schema (`policy.xsd` of sros2 0.13)."""
