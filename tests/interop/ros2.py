"""Nodes of ROS 2 Jazzy, from its wheels, with nothing of this machine's environment.

The wheels' Fast DDS has no security: a node that would be secured says so and ends. That it
gets there shows that ROS 2 took the environment, the keystore and the enclave.
"""

import os
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

NODE = """
import sys, rclpy
rclpy.init(args=sys.argv)
rclpy.create_node("talker")
print("the node lives")
"""


@dataclass(frozen=True)
class Run:
    """What became of a node."""

    code: int
    said: str

    @property
    def lives(self) -> bool:
        return self.code == 0 and "the node lives" in self.said


@dataclass(frozen=True)
class Ros2:
    """A venv with the wheels."""

    folder: Path

    @classmethod
    def find(cls) -> "Ros2 | None":
        """What .ci/ros2 made; PQSEC_ROS2 names another folder."""
        cached = Path.home() / ".cache" / "pqsec-ci" / "ros2"
        folder = Path(os.environ.get("PQSEC_ROS2", cached))
        return cls(folder) if (folder / "bin" / "python").exists() else None

    def node(self, work: Path, script: str, *arguments: str) -> Run:
        """A node, started in folder `work` by a shell that has run `script`."""
        command = shlex.join([str(self.folder / "bin" / "python"), "-c", NODE, *arguments])
        done = subprocess.run(
            ["sh", "-euc", f"{script}\nexec {command}"],
            cwd=work,
            env={"PATH": "/usr/bin:/bin"} | self.variables(work),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=300,
            check=False,
        )
        return Run(done.returncode, done.stdout)

    @property
    def libraries(self) -> list[Path]:
        """The folders with the wheels' libraries."""
        return [self.folder / "lib", *self.folder.glob("lib/python*/site-packages/*.libs")]

    def variables(self, work: Path) -> dict[str, str]:
        """What the wheels need, for a process that works in `work`."""
        return {
            "HOME": str(work),
            "LANG": "C.UTF-8",
            "LD_LIBRARY_PATH": ":".join(map(str, self.libraries)),
            "AMENT_PREFIX_PATH": str(self.folder),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF",
            "ROS_LOG_DIR": str(work / "log"),
            "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",  # else they start another Python
        }
