"""What the plugin costs a process of Cyclone DDS, against Cyclone's own plugins in the same run.

Real processes on the loopback: one reads, one writes. Medians of rounds in turn. It takes a C
compiler, cyclonedds-dev and cyclonedds-tools.
"""

import os
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from bench.agent_memory import megabytes
from pqsec_pki.plugin import AgentFolder, build, stop_agent
from tests.interop.conftest import LAB_PROFILES, Lab
from tests.interop.cyclone import find_plugins
from tests.interop.plugin.conftest import Shim
from tests.interop.plugin.processes import Stage

DOMAIN, SECONDS, MANY = 5, 20, 50
PEERS = Path(__file__).parents[1] / "pqsec_pki" / "trial" / "peers"
BASE = ("classical", "cyclones cyclones")
CASES = (BASE, *((profile, "ours ours") for profile in LAB_PROFILES if "rsa" not in profile))
HEADS = ("profile", "plugins", "made", "matched", "host kB", "more")


def compiled(folder: Path) -> Path:
    shutil.copy(PEERS / "Sample.idl", folder)
    source = Path(__file__).with_name("plugin_process.c")
    subprocess.run(["idlc", "Sample.idl"], cwd=folder, check=True, capture_output=True)
    words = ["cc", "-O1", "-I.", "-o", "host", source, "Sample.c", "-lddsc"]
    subprocess.run(words, cwd=folder, check=True)
    return folder / "host"


class Host:
    """A process, and the numbers that it says."""

    def __init__(self, command: list[str | Path], environment: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            command,
            env=os.environ | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.said: dict[str, list[float]] = {}

    def until(self, word: str) -> list[float]:
        assert self.process.stdout
        for line in self.process.stdout:
            name, *numbers = line.split()
            self.said[name] = [float(each) for each in numbers]
            if name == word:
                return self.said[name]
        raise SystemExit(f"a host ended before it was {word}: {self.process.args}")


@contextmanager
def host(
    program: Path, what: str, environment: dict[str, str], count: int = 1, seconds: int = 0
) -> Iterator[Host]:
    """A process with so many participants, which waits so long for one to be matched."""
    one = Host([program, what, str(DOMAIN), str(count), str(seconds)], environment)
    try:
        yield one
    finally:
        one.process.communicate()


def memory(process: int) -> int:
    """Kilobytes private to a process."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))


def meet(program: Path, stage: Stage, lab: Lab, plugins: str) -> dict[str, list[float]]:
    """What the writer says, once the reader is there."""
    reads, writes = (stage.environment(each, plugins=plugins) for each in (lab.bob, lab.alice))
    with host(program, "read", reads, seconds=SECONDS) as reader:
        reader.until("ready")
        time.sleep(0.2)
        with host(program, "write", writes, seconds=SECONDS) as writer:
            writer.until("matched")
            return writer.said


def first(program: Path, environment: dict[str, str]) -> float:
    """Milliseconds that a first participant takes."""
    with host(program, "read", environment) as one:
        return one.until("made")[0]


def many(program: Path, environment: dict[str, str], place: AgentFolder) -> tuple[float, float]:
    """Milliseconds for one participant more, and the agent's kilobytes for it."""
    with host(program, "read", environment) as one:
        one.until("ready")
        before = _agent(place)
    with host(program, "read", environment, MANY) as crowd:
        crowd.until("ready")
        each = (_agent(place) - before) / (MANY - 1)
        return crowd.said["more"][0], each


def _agent(place: AgentFolder) -> int:
    """Kilobytes of the agent and its workers."""
    return round(1024 * megabytes(place))


def measure(rounds: int) -> None:
    plugins = find_plugins()
    if plugins is None:
        raise SystemExit("apt-get install libddsc0debian cyclonedds-dev cyclonedds-tools")
    with tempfile.TemporaryDirectory(prefix="pqsec-") as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        folder = Path(name)
        (folder / "c").mkdir()
        program = compiled(folder / "c")
        place = AgentFolder.of(os.environ)
        shim = Shim(build(folder / "plugin").library.parent, place)
        configurations = folder / "xml"
        configurations.mkdir()
        stage = Stage(None, shim, plugins, configurations)
        now = datetime.now(UTC)
        labs = {
            each: Lab.create(folder / each, LAB_PROFILES[each], now)
            for each in {profile for profile, _ in CASES}
        }
        try:
            _measure(program, stage, labs, place, rounds)
        finally:
            stop_agent(place)


def _measure(
    program: Path, stage: Stage, labs: dict[str, Lab], place: AgentFolder, rounds: int
) -> None:
    cold = []
    environment = stage.environment(labs["pq"].alice)
    for _ in range(rounds):
        stop_agent(place)
        time.sleep(0.1)
        cold.append(first(program, environment))
    agent = _agent(place)
    taken: dict[tuple[str, str], list[dict[str, list[float]]]] = {case: [] for case in CASES}
    for _ in range(rounds):
        for profile, plugins in CASES:
            taken[profile, plugins].append(meet(program, stage, labs[profile], plugins))
    print(("{:<12} {:<18} " + "{:>9} " * 4).format(*HEADS))
    base = None
    for (profile, plugins), said in taken.items():
        middle = [
            statistics.median(each[word][index] for each in said)
            for word, index in (("made", 0), ("matched", 0), ("matched", 1))
        ]
        more, kilobytes = many(
            program, stage.environment(labs[profile].alice, plugins=plugins), place
        )
        base = base or [*middle, more]
        print(f"{profile:<12} {plugins:<18} " + _row([*middle, more], base) + f"  {kilobytes:.0f}")
    print(f"first participant with no agent: {statistics.median(cold):.0f} ms")
    print(f"an agent that has served one: {agent} kB; after all of this {_agent(place)} kB")
    print("milliseconds and kilobytes, in brackets over Cyclone's own; the last number is the")
    print("agent's kilobytes for each participant more")


def _row(numbers: list[float], base: list[float]) -> str:
    return " ".join(
        f"{each:8.2f} ({each - zero:+.2f})" for each, zero in zip(numbers, base, strict=True)
    )
