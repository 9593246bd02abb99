"""How long the first participant waits for the agent, against importing two libraries.

    no agent      a process starts it, as the plugin does
    no worker     the agent has stayed, and its last worker has ended
    a worker      other hosts are served

Each is what a host asks for a participant, over the socket, without the DDS stack. The ratios are
of the medians of real time, to a Python that imports cryptography and lxml in the same run, so the
machine should be idle; `startup.py --instructions` counts what the agent loads on a busy one.
Run: python bench/first_participant.py [ROUNDS]
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has the shim's side of the socket

from bench.agent_memory import enclaves
from bench.startup import LIBRARIES
from pqsec_pki.plugin import AgentFolder, agent_status, stop_agent
from pqsec_pki.plugin.control import Client
from tests.unit.plugin_wire import new_guid, properties

ROUNDS = 7
START = "import gc; gc.disable(); from pqsec_pki.plugin.__main__ import start; start()"
TOPIC = "DCPSParticipantsSecure"


def participant(place: AgentFolder, enclave: Path) -> tuple[Client, Client]:
    """What Cyclone DDS asks until a participant exists."""
    pairs, where = properties(enclave)
    asks, allows = Client(place, "authentication"), Client(place, "access_control")
    _, (own, *_) = asks.call("validate_local_identity", 0, where, pairs, new_guid())
    asks.call("get_identity_token", own)
    _, (rights, _) = allows.call("validate_local_permissions", own, 0, where, pairs)
    allows.call("check_create_participant", rights, 0)
    _, (token,) = allows.call("get_permissions_token", rights)
    _, (credential,) = allows.call("get_permissions_credential_token", rights)
    asks.call("set_permissions_credential_and_token", own, credential, token)
    allows.call("get_participant_sec_attributes", rights)
    allows.call("get_endpoint_sec_attributes", rights, TOPIC)
    return asks, allows


def started(place: AgentFolder) -> None:
    command = [sys.executable, "-I", "-c", START, "--detach", str(place.socket)]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)


def left(place: AgentFolder) -> None:
    """Wait until the agent has no worker."""
    while (found := agent_status(place)) and found.workers:
        time.sleep(2)  # in which nobody asks


def seconds(work: Callable[[], object]) -> float:
    before = time.perf_counter()
    work()
    return time.perf_counter() - before


def one_round(place: AgentFolder, enclave: Path) -> dict[str, float]:
    links: list[Client] = []

    def join() -> None:
        links.extend(participant(place, enclave))

    def cold() -> None:
        started(place)
        join()

    taken = {"no agent": seconds(cold), "a worker": seconds(join)}
    for each in links:
        each.close()
    left(place)
    taken["no worker"] = seconds(join)
    for each in links[-2:]:
        each.close()
    imports = [sys.executable, "-I", "-c", LIBRARIES]
    taken["imports"] = seconds(lambda: subprocess.run(imports, check=True))
    return taken


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    found: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory(prefix="pqsec-") as name:
        enclave, *_ = enclaves(Path(name, "keystore"))
        place = AgentFolder(Path(name, "agent.sock"))
        for _ in range(rounds):
            try:
                found.append(one_round(place, enclave))
            finally:
                stop_agent(place)
    floor = statistics.median(each["imports"] for each in found)
    for name in ("no agent", "no worker", "a worker", "imports"):
        middle = statistics.median(each[name] for each in found)
        print(f"{name:<10} {middle * 1000:7.1f} ms  {middle / floor:5.2f} x imports")


if __name__ == "__main__":
    main()
