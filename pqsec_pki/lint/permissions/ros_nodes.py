"""Rules about what every ROS 2 node needs; they run with `--target ros2`."""

import re
from collections.abc import Iterator

from pqsec_pki.documents import DefaultAction, PermissionRule, ros
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.documents._shadows import Patterns
from pqsec_pki.lint.permissions._names import shown
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR = Severity.ERROR
_TYPE_DESCRIPTION = re.compile(r"rr/(?P<node>.+)/get_parametersReply")


@lint_rule(
    "PQS267", ERROR, "a ROS 2 node without get_type_description",
    why="Since Iron, every node offers this service. Without permission for it, the node fails in"
    " its constructor. SROS2's own sample policy lacks it.",
    fix="Allow its topics, or create the permissions with `pqsec permissions import --complete`.",
    stacks=(Stack.ROS2,), measured="rclpy 7.1 (Jazzy) on Cyclone DDS 0.10.2",
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
    stacks=(Stack.ROS2,), measured="rclpy 7.1 (Jazzy) on Cyclone DDS 0.10.2",
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
