"""Rules about names of ROS 2, and about what every node needs (with `--target ros2`)."""

import re
from collections.abc import Iterator

from pqsec_pki.documents import DefaultAction, PermissionRule, ros
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.documents._shadows import Patterns
from pqsec_pki.lint.permissions._names import shown
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, INFO = Severity
_TYPE_DESCRIPTION = re.compile(r"rr/(?P<node>.+)/get_parametersReply")


@lint_rule(
    "PQS267", ERROR, "a ROS 2 node without get_type_description",
    why="Since Iron, every node offers this service. Without permission for it, the node fails in"
    " its constructor. SROS2's own sample policy lacks it.",
    fix="Allow its topics, or create the permissions with `pqsec permissions import --complete`.",
    stacks={Stack.ROS2: "Jazzy"}, measured="rclpy 7.1 (Jazzy) on Cyclone DDS 0.10.2",
    only_when_asked=True,
    bad="""
        <topics>
          <topic>ros_discovery_info</topic>
          <topic>rr/talker/get_parametersReply</topic>
        </topics>
    """,
    good="""
        <topics>
          <topic>ros_discovery_info</topic>
          <topic>rr/talker/get_parametersReply</topic>
          <topic>rr/talker/get_type_descriptionReply</topic>
        </topics>
    """,
)  # fmt: skip
def no_type_description(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        patterns = Patterns[PermissionRule]()
        topics = {
            topic: (criteria.line, rule)
            for rule in grant.rules
            if rule.allow
            for criteria in rule.publish
            for topic in criteria.topics
        }
        for topic, (_, rule) in topics.items():
            patterns.add(topic, rule)
        for topic, (line, _) in topics.items():
            found = _TYPE_DESCRIPTION.fullmatch(topic)
            wanted = f"rr/{found['node']}/get_type_descriptionReply" if found else ""
            if found and not next(patterns.covering(wanted), None):
                yield document.at(line, f"node /{found['node']} may not publish {wanted}")


@lint_rule(
    "PQS268", ERROR, f"a ROS 2 participant without {ros.DISCOVERY}",
    why="Every ROS 2 participant publishes and subscribes to this topic, and cannot start without"
    " it.",
    fix=f"Allow the participant to publish and to subscribe to {ros.DISCOVERY}.",
    stacks={Stack.ROS2: "Jazzy"}, measured="rclpy 7.1 (Jazzy) on Cyclone DDS 0.10.2",
    only_when_asked=True,
    bad="<publish><topics><topic>rt/chatter</topic></topics></publish>",
    good="""
        <publish>
          <topics>
            <topic>rt/chatter</topic>
            <topic>ros_discovery_info</topic>
          </topics>
        </publish>
    """,
)  # fmt: skip
def no_ros_discovery(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for action in ("publish", "subscribe"):
            patterns = Patterns[PermissionRule]()
            for rule in grant.rules:
                for criteria in getattr(rule, action) if rule.allow else ():
                    for topic in criteria.topics:
                        patterns.add(topic, rule)
            if grant.default is DefaultAction.DENY and not any(patterns.covering(ros.DISCOVERY)):
                yield document.at(grant.line, f"{shown(grant)} may not {action} {ros.DISCOVERY}")


@lint_rule(
    "PQS276", WARNING, "a ROS 2 topic with a doubled slash",
    why="ROS 2 accepts no name with `//`, so no node uses this topic.",
    fix="Write one slash, or use --ros-publish and --ros-subscribe, which check the name.",
    bad="<topic>rt//scan</topic>",
    good="<topic>rt/scan</topic>",
)  # fmt: skip
def doubled_slash(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("topic"):
        if ros.doubled_slash(node.value):
            yield document.at(node, f"{node.value[:60]!a}: no ROS 2 name has //")


@lint_rule(
    "PQS277", INFO, "a ROS 2 name as DDS topic",
    why="In DDS, the topic /chatter of ROS 2 has the name rt/chatter. Only a node that avoids the"
    " naming conventions of ROS 2 uses /chatter itself.",
    fix="Write rt/chatter, or use --ros-publish and --ros-subscribe.",
    bad="<topic>/chatter</topic>",
    good="<topic>rt/chatter</topic>",
)  # fmt: skip
def ros_name(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("topic"):
        if ros.is_ros_name(node.value):
            yield document.at(node, f"{node.value[:60]!a}: ROS 2 nodes use rt{node.value[:60]}")
