"""Reads the ROS 2 nodes of a policy in YAML: their names become DDS topics.

    nodes:
      - node: /robot/planner
        publish: [plan, ~/debug]
        clients: [/map_server/map]
        use_sim_time: true

Names are resolved as ROS 2 does: `plan` is in the node's namespace, `~/debug` below the
node. Each node gets the topics that it needs to start, unless it has `minimum: false`.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from pqsec_pki.documents import ros
from pqsec_pki.documents._yaml import Item, Text, refused
from pqsec_pki.documents._yaml_reading import boolean, build, fields, one_or_more, text
from pqsec_pki.documents.ros import Endpoints
from pqsec_pki.errors import UsageError

USES: Mapping[str, Callable[[str], Endpoints]] = {
    "publish": ros.topic_publisher,
    "subscribe": ros.topic_subscriber,
    "services": ros.service_server,
    "clients": ros.service_client,
    "action_servers": ros.action_server,
    "action_clients": ros.action_client,
    "parameters_of": ros.parameter_client,
    "lifecycle_of": ros.lifecycle_client,
}
"""Key -> function that returns the DDS topics of each name under the key."""


def node(item: Item) -> Endpoints:
    """What one node may publish and subscribe to; with only a name, what it needs to start."""
    if isinstance(item, Text):
        return build(item, _minimum_of, written=text(item))
    given = fields(
        item,
        {
            "node": _with_line,
            "namespace": text,
            **dict.fromkeys(USES, partial(one_or_more, reader=_with_line)),
            **dict.fromkeys(("lifecycle", "use_sim_time", "minimum"), boolean),
        },
        required=("node",),
    )
    place, written = given["node"]
    name = build(place, _node_name, written=written, namespace=given.get("namespace", "/"))
    return Endpoints.joined([*_whole(name, given), *_uses(name, given)])


def _with_line(item: Item) -> tuple[Item, str]:
    return item, text(item)


def _node_name(*, written: str, namespace: str) -> str:
    """The full name; in ROS 2 the namespace is separate, but users often write both as one."""
    if written.startswith("~"):
        raise UsageError(f"{written!r} is not a node name such as /talker")
    if written.startswith("/") and namespace != "/":
        raise UsageError(f"{written!r} is a full name: remove `namespace`")
    return ros.resolve(written, f"{namespace.rstrip('/')}/node")


def _minimum_of(*, written: str) -> Endpoints:
    return ros.node_minimum(_node_name(written=written, namespace="/"))


def _whole(name: str, given: Mapping[str, Any]) -> Iterator[Endpoints]:
    if given.get("minimum", True):
        yield ros.node_minimum(name)
    if given.get("lifecycle"):
        yield ros.lifecycle_node(name)
    if given.get("use_sim_time"):
        yield ros.simulated_time()


def _uses(name: str, given: Mapping[str, Any]) -> Iterator[Endpoints]:
    for key, use in USES.items():
        for item, written in given.get(key, ()):
            if "*" in written or "?" in written:
                example = "write patterns outside `nodes`, in DDS form: publish: ['rt/chat*']"
                raise refused(item, f"{key}: {example}")
            yield build(item, partial(_use, use), name=name, written=written)


def _use(use: Callable[[str], Endpoints], *, name: str, written: str) -> Endpoints:
    return use(ros.resolve(written, name))
