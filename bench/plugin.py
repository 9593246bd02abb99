"""What pqsec's plugin costs, against the stacks' own plugins in the same run; three parts.

    sample    until the first sample in Cyclone DDS, Fast DDS and OpenDDS (plugin_sample.py)
    process   of Cyclone DDS: to create and to match participants, and memory (plugin_process.py)
    hosts     many that start at once, in Cyclone DDS and Fast DDS (`pqsec bench --stack`)

Run: python bench/plugin.py [PART...] [--rounds N] [--hosts N]; by default all parts. The files say
what each takes. Run it on an idle machine: peers and agent share its cores.
"""

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has what runs the stacks

from bench import plugin_process, plugin_sample

OWN, OURS = ("classical", "stock"), ("pq", "pqsec")
COLUMNS = ("stack", "plugins", "hosts", "met all", "full s", "hosts s", "agent s", "agent MB")


def runs(stack: str, profile: str, plugins: str, hosts: int, rounds: int) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "pqsec_pki", "bench", "--stack", stack, "--json"]
    command += ["--profile", profile, "--plugins", plugins, "--hosts", str(hosts)]
    command += ["--rounds", str(rounds), "--timeout", "90", "--samples", "0"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    found: list[dict[str, Any]] = json.loads(done.stdout)["runs"]
    return found


def middle(found: list[dict[str, Any]], name: str) -> float:
    return statistics.median(each[name] or 0 for each in found)


def many_hosts(hosts: int, rounds: int) -> None:
    print(("{:<12} {:<18} " + "{:>9} " * (len(COLUMNS) - 2)).format(*COLUMNS))
    for stack in ("cyclonedds", "fastdds"):
        taken = {}
        for profile, plugins in (OWN, OURS):
            found = taken[plugins] = runs(stack, profile, plugins, hosts, rounds)
            print(
                f"{stack:<12} {f'{profile}, {plugins}':<18} {hosts:9} "
                f"{middle(found, 'complete'):9.0f} {middle(found, 'full_s'):9.2f} "
                f"{middle(found, 'hosts_cpu_s'):9.1f} {middle(found, 'agent_cpu_s'):9.1f} "
                f"{middle(found, 'agent_kb') / 1024:9.0f}",
                flush=True,
            )
        if all(each["full_s"] for found in taken.values() for each in found):
            base, ours = (middle(found, "full_s") for found in taken.values())
            print(f"  full mesh: {ours / base:.2f} x the stack's own")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("parts", nargs="*", metavar="PART")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--hosts", type=int, default=20)
    words = parser.parse_args()
    parts = {
        "sample": lambda: plugin_sample.measure(words.rounds),
        "process": lambda: plugin_process.measure(words.rounds),
        "hosts": lambda: many_hosts(words.hosts, words.rounds),
    }
    if unknown := set(words.parts) - parts.keys():
        parser.error(f"no part {min(unknown)}: {', '.join(parts)}")
    for part in words.parts or parts:
        print(f"== {part}", flush=True)
        parts[part]()


if __name__ == "__main__":
    main()
