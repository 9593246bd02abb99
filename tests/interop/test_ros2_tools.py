"""ROS 2's own tools find pqsec: `ros2 pqsec`, and launch files with nodes that run secured.

No registry has these tools: PQSEC_ROS2_TOOLS names an environment that has them. So these tests are
not part of the gate.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from pqsec_pki.trial.network import alone
from tests.interop.conftest import LAB_PROFILES
from tests.interop.crew import Crew
from tests.interop.nodes import LOOPBACK, SOURCES

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "examples" / "launch" / "policy.yaml"
LIMIT = 90
"""Seconds that a launch gets."""
TOOLS = Path(os.environ.get("PQSEC_ROS2_TOOLS", "/none"))
"""A virtual environment with ros2cli, launch, launch_ros, rclpy and this checkout."""
pytestmark = [
    pytest.mark.interop,
    pytest.mark.skipif(
        not (TOOLS / "bin" / "ros2").exists(),
        reason="no ros2cli and launch: PQSEC_ROS2_TOOLS names no environment that has them",
    ),
]


@pytest.fixture(scope="module")
def crew(tmp_path_factory, now) -> Crew:
    folder = tmp_path_factory.mktemp("tools")
    return Crew.create(folder, LAB_PROFILES["transition"], now, POLICY.read_bytes())


@pytest.fixture
def tool(ros2, tmp_path):
    """tool("pqsec", ...) is what became of `ros2 pqsec ...`."""

    def run(*words, **more) -> subprocess.CompletedProcess[str]:
        command = [TOOLS / "bin" / "ros2", *map(str, words)]
        variables = {**ros2.variables(tmp_path), "PATH": f"{TOOLS}/bin:/usr/bin:/bin", **more}
        variables["AMENT_PREFIX_PATH"] += f":{TOOLS}"
        return alone(
            lambda _: subprocess.run(
                command,
                cwd=tmp_path,
                env=variables,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=LIMIT,
                check=False,
            )
        )

    return run


@pytest.fixture
def launch(tool, tmp_path):
    """launch(text of a launch file) is its output, with errors."""

    def run(text, name="some.launch.py", **more) -> str:
        path = tmp_path / name
        path.write_text(text)
        done = tool("launch", path, **more)
        return done.stdout + done.stderr

    return run


@pytest.fixture
def on_cyclone(nodes, crew, tmp_path, launch):
    """Likewise, with all processes on a Cyclone DDS with security, and names for the file."""
    configuration = tmp_path / "loopback.xml"
    configuration.write_text(LOOPBACK)

    def run(body) -> str:
        return launch(
            HEAD + body,
            CYCLONEDDS_URI=configuration.as_uri(),
            LD_PRELOAD=str(nodes.rmw),
            RMW_IMPLEMENTATION="rmw_cyclonedds_cpp",
            ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET",
            NODE=str(SOURCES / "node.py"),
            KEYSTORE=str(crew.keystore.root),
        )

    return run


HEAD = """
import os, shlex
from launch import LaunchDescription
from launch.actions import *
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown, matches_action
from launch_ros.actions import ComposableNodeContainer, LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition
from pqsec_pki.ros.launch import SecuredGroup, SecuredLaunchNode

KEYS = "-k " + shlex.quote(os.environ["KEYSTORE"])
PYTHON = shlex.quote(os.environ.get("PYTHON", "python"))

def node(does, name, kind=Node, seconds=60, **more):
    words = [os.environ["NODE"], does, "0", "/chatter", "text", str(seconds), name]
    namespace, _, base = name.rpartition("/")
    return kind(executable="python", arguments=words, name=base, namespace=namespace or "/",
                output="screen", **more)

def ends(action):
    return RegisterEventHandler(
        OnProcessExit(target_action=action, on_exit=[EmitEvent(event=Shutdown())]))
"""


def test_ros2_pqsec_is_pqsec(tool, crew):
    keys = ("-k", crew.keystore.root)
    done = tool("pqsec", *keys, "status", "--json")
    assert {each["name"] for each in json.loads(done.stdout)["participants"]} >= {"/robot1/base"}
    assert "pqsec" in tool("-h").stdout
    assert "Usage: pqsec issue" in tool("pqsec", "issue", "--help").stdout
    assert tool("pqsec", *keys, "needs-renewal", "/robot1/base").returncode == 1
    done = tool("pqsec", *keys, "export", "ros2", "/nobody")
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("pqsec: error: there is no participant /nobody")
    assert tool("pqsec", "isue").returncode == 2


def test_the_nodes_of_a_group_run_secured(on_cyclone, crew):
    said = on_cyclone("""
base = node("idle", "/robot1/base", kind=ComposableNodeContainer, seconds=1)
def generate_launch_description():
    return LaunchDescription([SecuredGroup("/robot1/base", [base], options=KEYS), ends(base)])
""")
    assert f"Found security directory: {crew.keystore.root}/enclaves/robot1/base" in said
    assert "joined" in said
    assert "libdds_security_auth.so" in said


LIFECYCLE = """
camera = node("managed", "/robot1/camera", kind=LifecycleNode)
inactive = OnStateTransition(
    target_lifecycle_node=camera, goal_state="inactive",
    entities=[LogInfo(msg="the camera is inactive"), EmitEvent(event=Shutdown())])
configure = EmitEvent(event=ChangeState(
    lifecycle_node_matcher=matches_action(camera),
    transition_id=Transition.TRANSITION_CONFIGURE))
def generate_launch_description():
    return LaunchDescription([
        *OWN,
        SecuredGroup("/robot1/camera", [camera], options=KEYS),
        RegisterEventHandler(inactive), configure,
        TimerAction(period=float(PATIENCE), actions=[EmitEvent(event=Shutdown())]),
    ])
"""


@pytest.mark.parametrize(
    ("own", "patience", "changed"),
    [
        ('[SecuredLaunchNode("/robot1/launch", options=KEYS)]', 60, True),
        ('[SecuredLaunchNode("/robot1/operator", options=KEYS)]', 10, False),
    ],
    ids=["its enclave", "another's"],
)
def test_launch_changes_the_state_of_a_secured_node_with_its_own_enclave(
    on_cyclone, crew, own, patience, changed
):
    said = on_cyclone(LIFECYCLE.replace("OWN", own).replace("PATIENCE", str(patience)))
    enclave = own.split('"')[1]
    assert f"Found security directory: {crew.keystore.root}/enclaves{enclave}" in said
    assert ("the camera is inactive" in said) == changed


SHOW = "env | grep -E '^(ROS_SEC|ROS_DOM|OUT)' | sort"
XML = """
<launch>
  <secured_group enclave="/robot1/base" script="$(dirname)/base.sh">
    <executable cmd="sh -c &quot;{show}&quot;" output="screen"/>
  </secured_group>
  <executable cmd="sh -c &quot;echo OUT; {show}&quot;" output="screen"/>
</launch>
"""


def test_a_launch_file_in_xml_secures_a_group_and_nothing_else(launch, crew, tmp_path):
    shutil.copy(crew.script("/robot1/base"), tmp_path / "base.sh")
    said = launch(XML.format(show=SHOW), "some.launch.xml")
    assert said.count("ROS_SECURITY_ENABLE=true") == 1
    assert said.count("ROS_SECURITY_STRATEGY=Enforce") == 1
    assert said.count(f"ROS_SECURITY_KEYSTORE={crew.keystore.root}") == 1
    assert said.count("ROS_SECURITY_ENCLAVE_OVERRIDE=/robot1/base") == 1


PYTHON = """
from launch import LaunchDescription
from launch.actions import *
from pqsec_pki.ros.launch import SecuredGroup, SecuredLaunchNode
def generate_launch_description():
    process = dict(cmd=["echo", "it", "started"], output="screen")
    return LaunchDescription([{}])
"""


@pytest.mark.parametrize(
    ("action", "told"),
    [
        (
            'SecuredGroup("/robot1/base", [ExecuteProcess(**process)], script="/dev/null")',
            "/dev/null does not secure the nodes of /robot1/base",
        ),
        (
            'SecuredGroup("/robot1/base", [ExecuteProcess(**process)], script="no.sh")',
            "no.sh cannot be read",
        ),
        (
            'SecuredGroup("/nobody", [ExecuteProcess(**process)], options="-k none")',
            "pqsec export ros2 /nobody -k none failed with exit code 3",
        ),
        (
            'SecuredGroup("/robot1/base", [ExecuteProcess(env={"A": "b"}, **process)])',
            "ExecuteProcess with env gets no other variables",
        ),
        (
            'SecuredGroup("/robot1/base", [TimerAction(period=0.1, actions=[])])',
            "TimerAction starts nodes after the group, unsecured",
        ),
        (
            'SecuredLaunchNode("/robot1/launch", script="late.sh")',
            "LD_LIBRARY_PATH is read when a process starts",
        ),
    ],
)
def test_what_would_not_be_secured_does_not_start(launch, crew, tmp_path, action, told):
    late = crew.script("/robot1/launch").read_text() + "export LD_LIBRARY_PATH=/opt/pqsec\n"
    (tmp_path / "late.sh").write_text(late)
    said = launch(PYTHON.format(action))
    assert told in said
    assert "it started" not in said
