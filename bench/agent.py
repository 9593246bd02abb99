"""Many hosts that start at once: pqsec's plugin against Cyclone DDS's own, in one run.

Real processes on the loopback, each a participant with a writer and a reader of one topic; all of
them start together and meet each other. For each number of hosts, the table has how many got no
participant, how many died, the time until the last had met all others, processor time, and the
memory of the agent and its workers (proportional, so what they share counts once).

Run: python bench/agent.py [HOSTS...] [--seconds N] [--rest N]; by default 20 hosts. It takes a C
compiler, cyclonedds-dev and cyclonedds-tools. Run it on an idle machine: hosts and agent share its
cores.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has what runs Cyclone DDS

from bench.agent_memory import megabytes
from bench.plugin import DOMAIN, PEERS
from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import FileError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.plugin import AgentFolder, agent_status, build, stop_agent
from tests.interop.conftest import TOPIC
from tests.interop.cyclone import find_plugins
from tests.interop.plugin.conftest import Shim
from tests.interop.plugin.processes import Stage

CASES = (("classical", "cyclones cyclones"), ("pq", "ours ours"))
DAY = timedelta(days=1)
HEADS = (
    "plugins",
    "hosts",
    "refused",
    "dead",
    "met all",
    "created s",
    "full s",
    "hosts s",
    "agent s",
)


@dataclass
class Host:
    """A process, and what it says: a word, and the seconds since all were started."""

    process: subprocess.Popen[str]
    said: dict[str, float] = field(default_factory=dict)

    def listen(self, start: float) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            self.said[line.split()[0]] = time.monotonic() - start


@dataclass
class Crowd:
    """What hosts that started together took."""

    hosts: list[Host]
    processor: float
    """Seconds of all hosts."""
    agent: float
    """Those of the agent and its workers."""
    peak: float
    """Megabytes."""

    def times(self, word: str) -> list[float]:
        return [each.said[word] for each in self.hosts if word in each.said]

    @property
    def dead(self) -> int:
        return sum((each.process.returncode or 0) < 0 for each in self.hosts)


class Meeting:
    """Hosts of one keystore and one plugin."""

    def __init__(self, program: Path, environments: list[dict[str, str]], seconds: int) -> None:
        self._program, self._environments, self._seconds = program, environments, seconds

    def hold(self, place: AgentFolder) -> Crowd:
        words = [str(self._program), str(DOMAIN), str(len(self._environments)), str(self._seconds)]
        start = time.monotonic()
        hosts = [
            Host(
                subprocess.Popen(
                    words,
                    env=os.environ | each,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    text=True,
                )
            )
            for each in self._environments
        ]
        threads = [threading.Thread(target=each.listen, args=(start,)) for each in hosts]
        for thread in threads:
            thread.start()
        peak = 0.0
        while not all(_is_done(each) for each in hosts):
            time.sleep(0.5)
            with suppress(FileError):  # on cores that 100 hosts share, it may take seconds
                peak = max(peak, megabytes(place))
        status = agent_status(place)
        agent = sum(map(_seconds, (status.process, *status.workers))) if status else 0.0
        processor = sum(_seconds(each.process.pid) for each in hosts)
        for each in hosts:
            assert each.process.stdin
            each.process.stdin.close()
        for each, thread in zip(hosts, threads, strict=True):
            each.process.wait()
            thread.join()
        return Crowd(hosts, processor, agent, peak)


def _is_done(host: Host) -> bool:
    return host.process.poll() is not None or bool({"full", "short"} & set(host.said))


def _seconds(process: int) -> float:
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:  # it has ended
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def enclaves(root: Path, profile: str, count: int) -> list[Path]:
    now, domains = datetime.now(UTC), DomainSet.parse("0-10")
    names = [f"/host{number}" for number in range(count)]
    store = Keystore.create(
        root,
        profile_named(profile),
        name="Bench",
        domains=domains,
        validity=900 * DAY,
        passphrase=None,
        now=now,
    )
    may = {"publish": (TOPIC,), "subscribe": (TOPIC,), "domains": domains, "validity": 90 * DAY}
    issue(store, store.unlock(None), [ParticipantSpec(name=name, **may) for name in names], now=now)
    return [root / f"enclaves{name}" for name in names]


def compiled(folder: Path) -> Path:
    shutil.copy(PEERS / "Sample.idl", folder)
    subprocess.run(["idlc", "Sample.idl"], cwd=folder, check=True, capture_output=True)
    source = Path(__file__).with_name("agent_host.c")
    words = ["cc", "-O1", "-I.", "-o", "host", source, "Sample.c", "-lddsc"]
    subprocess.run(words, cwd=folder, check=True)
    return folder / "host"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("hosts", nargs="*", type=int, default=[20])
    parser.add_argument("--seconds", type=int, default=90, help="for all hosts to meet")
    parser.add_argument("--rest", type=int, default=60, help="until the memory is read again")
    words = parser.parse_args()
    plugins = find_plugins()
    if plugins is None:
        raise SystemExit("apt-get install libddsc0debian cyclonedds-dev cyclonedds-tools")
    with tempfile.TemporaryDirectory(prefix="pqsec-") as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        folder = Path(name)
        for each in ("c", "xml"):
            (folder / each).mkdir()
        place = AgentFolder.of(os.environ)
        shim = Shim(build(folder / "plugin").library.parent, place)
        stage = Stage(None, shim, plugins, folder / "xml", most=max(words.hosts) + 10)
        program = compiled(folder / "c")
        most = {
            profile: enclaves(folder / profile, profile, max(words.hosts)) for profile, _ in CASES
        }
        print(("{:<20} " + "{:>9} " * (len(HEADS) - 1)).format(*HEADS))
        for count in words.hosts:
            taken = []
            for profile, kind in CASES:
                environments = [stage.environment(each, plugins=kind) for each in most[profile]]
                meeting = Meeting(program, environments[:count], words.seconds)
                taken.append(meeting.hold(place))
                print(_row(f"{profile}, {kind.split()[0]}", taken[-1]), flush=True)
            _compare(place, taken, words.rest)


def _row(name: str, crowd: Crowd) -> str:
    created, full = crowd.times("made"), crowd.times("full")
    numbers = (
        f"{len(crowd.hosts):9} {len(crowd.times('refused')):9} {crowd.dead:9} {len(full):9} "
        f"{statistics.median(created or [0]):9.2f} {max(full, default=0):9.2f} "
        f"{crowd.processor:9.1f} {crowd.agent:9.1f}"
    )
    return f"{name:<20} {numbers}"


def _compare(place: AgentFolder, taken: list[Crowd], rest: int) -> None:
    """The ratios, and what the agent holds with hosts and without."""
    base, ours = (max(crowd.times("full"), default=0.0) for crowd in taken)
    both = base and ours
    print(f"  full mesh: {ours / base:.2f} x Cyclone's own" if both else "  nobody met all others")
    work = (taken[1].processor + taken[1].agent) / taken[0].processor
    print(f"  processor: {work:.2f} x Cyclone's own, {taken[1].agent:.1f} s of it the agent's")
    time.sleep(rest)
    left = megabytes(place)
    print(f"  agent: {taken[1].peak:.0f} MB at most, {left:.0f} MB after {rest} s without hosts")
    if taken[1].dead or taken[1].times("refused"):
        print(place.log.read_text())
    stop_agent(place)


if __name__ == "__main__":
    main()
