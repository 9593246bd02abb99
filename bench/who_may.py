"""`pqsec who-may` and `report` of 2,000 robots in three domains: CPU and the most memory.

Each robot may use its own topics, those of its ROS 2 node and two of its fleet. Every
certificate and document is verified. The time of the processor counts, of which other work on
the machine takes nothing; the clock stands beside it, since work is shared out to the cores. Memory
is the largest resident set of one process, as the system counts it. The modules are compiled
before, as where pqsec is installed.
Run: python bench/who_may.py [--count 2000] [--folder DIR]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue

SECONDS, MEBIBYTES = 5, 200
REPORT_SECONDS = 10
DOMAINS = 3
COMMANDS = (["who-may"], ["who-may", "--json"], ["report"])
YEAR = timedelta(days=365)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2_000)
    parser.add_argument("--folder", help="where to make the keystore")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        root = Path(folder) / "k"
        populate(root, options.count)
        compile_modules(Path(folder))
        for words in COMMANDS:
            seconds, clock, size, written = cost("-k", root, *words)
            print(
                f"{' '.join(words):<16} {options.count} participants {seconds:6.2f} s of CPU"
                f" {clock:6.2f} s {size:5.0f} MiB {written / 2**20:5.1f} MiB written"
            )
    print(f"target: who-may of 2000 in at most {SECONDS} s of CPU and {MEBIBYTES} MiB")
    print(f"target: report of 2000 in at most {REPORT_SECONDS} s")


def compile_modules(folder: Path) -> None:
    """Compile all modules, into the folder where the environment does not let Python do it."""
    os.environ["PYTHONPYCACHEPREFIX"] = str(folder / "compiled")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    populate(folder / "small", 2)
    for words in COMMANDS:
        cost("-k", folder / "small", *words)


def populate(root: Path, count: int) -> None:
    now = datetime.now(UTC)
    keystore = Keystore.create(
        root,
        profile_named("classical"),
        name="Bench",
        domains=DomainSet.parse(f"0-{DOMAINS - 1}"),
        validity=YEAR,
        passphrase=None,
        now=now,
    )
    issue(keystore, keystore.unlock(None), [robot(number) for number in range(count)], now=now)


def robot(number: int) -> ParticipantSpec:
    name = f"/robot{number}"
    needs = ros.node_minimum(name)
    return ParticipantSpec(
        name=name,
        domains=DomainSet.of(number % DOMAINS),
        publish=(*needs.publish, f"rt{name}/odom", "rt/fleet/status"),
        subscribe=(*needs.subscribe, f"rt{name}/cmd_vel", "rt/fleet/command"),
        validity=YEAR,
    )


def cost(*words: object) -> tuple[float, float, float, int]:
    """Seconds of the processor and of the clock, most MiB, and bytes written, of that command."""
    line = [sys.executable, "-m", "pqsec_pki", *map(str, words)]
    begun = time.perf_counter()
    with subprocess.Popen(line, stdout=subprocess.PIPE) as process:
        assert process.stdout
        written = sum(len(piece) for piece in iter(lambda: process.stdout.read(1 << 16), b""))
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    clock = time.perf_counter() - begun
    return used.ru_utime + used.ru_stime, clock, used.ru_maxrss / 1024, written


if __name__ == "__main__":
    main()
