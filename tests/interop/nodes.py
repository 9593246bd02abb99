"""Real nodes of rclpy on real Cyclone DDS, with what `pqsec export ros2` writes.

The wheels have no rmw_cyclonedds: rmw/rmw.cpp stands in for it, compiled for the run. Who has the
real one, for the same wheels, names the library in PQSEC_RMW_CYCLONEDDS, and the tests run on it.
"""

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from pqsec_pki.trial import TrialRole, TrialRun, TrialSetup, run_peers
from pqsec_pki.trial.network import alone
from pqsec_pki.trial.peer import PeerOutcome, running_peer
from tests.interop.ros2 import Ros2
from tests.interop.strangers import run_strangers

TOPIC = "/chatter"
PATIENCE = 40.0
"""Seconds that what should come about gets: both cores may be busy."""
REFUSAL = 4.0
"""What should not."""
SOURCES = Path(__file__).parent / "rmw"
_LIBRARIES = (
    *("ddsc", "fastcdr", "rcutils", "rmw", "rmw_dds_common", "rosidl_runtime_c"),
    "rosidl_typesupport_fastrtps_c",
)
_START = """
. "$NODE_SCRIPT"
exec env LD_PRELOAD="$NODE_RMW" "$NODE_PYTHON" "$NODE_PROGRAM" "$@" $NODE_NAMES $NODE_ARGUMENTS
"""
LOOPBACK = """<CycloneDDS><Domain id="any">
<General>
 <Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
 <AllowMulticast>false</AllowMulticast>
</General>
<Discovery>
 <Peers><Peer address="127.0.0.1"/></Peers>
 <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>9</MaxAutoParticipantIndex>
</Discovery>
</Domain></CycloneDDS>
"""


class Does(StrEnum):
    """What the first node of a process does; rmw/node.py says it at length."""

    SEND = "send"
    RECEIVE = "receive"
    IDLE = "idle"
    RAISE = "raise"
    CALL = "call"
    CLOCK = "clock"
    MANAGED = "managed"
    SERVE = "serve"
    ACT = "act"


def compiled(ros2: Ros2, folder: Path) -> Path | None:
    """The library that goes between ROS 2 and Cyclone DDS; None without a compiler for it."""
    if real := os.environ.get("PQSEC_RMW_CYCLONEDDS"):
        return Path(real)
    if not all(map(shutil.which, ("idlc", "gcc", "g++"))):
        return None
    include, rmw = ros2.folder / "include", folder / "librmw.so"
    headers = [f"-I{each}" for each in (folder, include, *include.iterdir())]
    needed = [f"-Wl,-rpath-link,{each}" for each in ros2.libraries]
    libraries = [f"-L{ros2.folder / 'lib'}", *needed, *(f"-l{name}" for name in _LIBRARIES)]
    shared = ["-std=c++17", "-Wall", "-fPIC", "-shared", "-Wl,--no-undefined"]
    commands: Sequence[Sequence[str | Path]] = [
        ["idlc", SOURCES / "Frame.idl"],
        ["gcc", "-fPIC", "-c", "Frame.c"],
        ["g++", *shared, *headers, "-o", rmw, SOURCES / "rmw.cpp", "Frame.o", *libraries],
    ]
    for command in commands:
        subprocess.run(command, cwd=folder, check=True)
    return rmw


@dataclass(frozen=True)
class Nodes:
    """How to start them."""

    ros2: Ros2
    rmw: Path
    folder: Path
    """Where logs and configurations go."""

    def role(
        self,
        does: Does,
        *nodes: str,
        script: Path | None = None,
        enclave: str = "",
        text: str = "",
        unauthenticated: bool = False,
        **more: str,
    ) -> TrialRole:
        """A process with these nodes, after a shell has read `script`; `more` are variables.

        Its enclave is called as the first node, unless it is said.
        """
        loopback = self.folder / "loopback.xml"
        loopback.write_text(LOOPBACK)
        variables = {
            **self.ros2.variables(self.folder),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
            "CYCLONEDDS_URI": loopback.as_uri(),
            "NODE_RMW": str(self.rmw),
            "NODE_PYTHON": str(self.ros2.folder / "bin" / "python"),
            "NODE_PROGRAM": str(SOURCES / "node.py"),
            "NODE_SCRIPT": str(script or "/dev/null"),
            "NODE_NAMES": " ".join(nodes),
            "NODE_ARGUMENTS": f"--ros-args --enclave {enclave or nodes[0]}" if script else "",
        }
        variables |= more
        return TrialRole(
            name=nodes[0],
            act=does,
            text=text,
            environment=variables,
            unauthenticated=unauthenticated,
        )

    def run_peers(
        self, *roles: TrialRole, topic: str = TOPIC, seconds: float = PATIENCE
    ) -> TrialRun:
        """How it went, until the first process that is no stranger ended."""
        scene = TrialSetup(program=self._program, domain=0, topic=topic, timeout=seconds)
        return run_peers(scene, roles)

    def run_strangers(self, *roles: TrialRole, said: str = "") -> TrialRun:
        """How it went with some that should not meet, and when a log had `said`."""
        return run_strangers(self.run_peers, roles, (REFUSAL, PATIENCE), said)

    def one(self, role: TrialRole, seconds: float = 0.2) -> PeerOutcome:
        """What becomes of one process, for itself."""
        return self.beside(None, [role], seconds)[0]

    def beside(
        self, constant: TrialRole | None, roles: Sequence[TrialRole], *seconds: float
    ) -> list[PeerOutcome]:
        """What becomes of one process after the other, while `constant` goes on.

        The last account is that of `constant`, if there is one.
        """
        return alone(lambda _: self._beside(constant, roles, seconds))

    def _beside(self, constant, roles, seconds) -> list[PeerOutcome]:
        with ExitStack() as stack:
            first = stack.enter_context(self._playing(constant, 600)) if constant else None
            _wait(lambda: not first or first.ended or first.outcome.joined)
            outcomes = []
            for role, life in zip(roles, seconds, strict=True):
                with self._playing(role, life) as peer:
                    _wait(lambda peer=peer: peer.ended)
                    assert peer.ended, f"it hangs: {peer.outcome}"
                    outcomes.append(peer.outcome)
            return outcomes + ([first.outcome] if first else [])

    def _playing(self, role: TrialRole, seconds: float):
        return running_peer(self._program, role, domain=0, topic=TOPIC, seconds=seconds)

    @property
    def _program(self) -> list[str]:
        return ["sh", "-euc", _START, "node"]


def ended(outcome: PeerOutcome) -> bool:
    """Whether the process came to its own end, all nodes destroyed."""
    return outcome.signal is None and "ended" in outcome.log.splitlines()


def _wait(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < limit:
        time.sleep(0.02)
