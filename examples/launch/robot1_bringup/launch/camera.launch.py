"""A lifecycle node, which is configured when it has started."""

from launch import LaunchDescription
from launch.actions import EmitEvent
from launch.events import matches_action
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.events.lifecycle import ChangeState
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

from pqsec_pki.ros.launch import SecuredGroup, SecuredLaunchNode


def script(name: str) -> PathJoinSubstitution:
    share = FindPackageShare("robot1_bringup")
    return PathJoinSubstitution([share, "pqsec", "robot1", name, "ros2.sh"])


def generate_launch_description() -> LaunchDescription:
    camera = LifecycleNode(
        package="camera", executable="camera", name="camera", namespace="/robot1", output="screen"
    )
    configure = ChangeState(
        lifecycle_node_matcher=matches_action(camera),
        transition_id=Transition.TRANSITION_CONFIGURE,
    )
    return LaunchDescription(
        [
            SecuredLaunchNode("/robot1/launch", script=script("launch")),
            SecuredGroup("/robot1/camera", [camera], script=script("camera")),
            EmitEvent(event=configure),
        ]
    )
