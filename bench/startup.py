"""How long one command takes as a whole process, against its imports and against SROS2.

Whole processes, run in turn so that a drift of the machine's speed hits all alike; medians of the
processor's time. Run:

    python bench/startup.py [--sros2 PYTHON]

PYTHON is an interpreter that can import sros2, such as python3 after `source setup.bash` of ROS 2;
SROS2 then makes an enclave by the function behind `ros2 security create_enclave`.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROUNDS = 15
PQSEC = [sys.executable, "-m", "pqsec_pki"]
IMPORTS = "import click, cryptography.x509, jinja2, lxml.etree, yaml"
SROS2 = """
import pathlib, sys
from sros2.keystore import create_enclave
create_enclave(pathlib.Path(sys.argv[1]), sys.argv[2])
"""
SROS2_KEYSTORE = """
import pathlib, sys
from sros2.keystore import create_keystore
create_keystore(pathlib.Path(sys.argv[1]))
"""
PROFILES = ("classical", "pq", "transition")


def seconds(command: list[str]) -> float:
    """Of the processor, in that process and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def commands(folder: Path, sros2: str | None) -> dict[str, list[str]]:
    """Name -> a command, in which NAME is another participant each time."""
    found = {
        "bare Python": [sys.executable, "-c", "pass"],
        "importing click, cryptography, jinja2, lxml, yaml": [sys.executable, "-c", IMPORTS],
        "pqsec --version": [*PQSEC, "--version"],
        "pqsec --help": [*PQSEC, "--help"],
    }
    for profile in PROFILES:
        keystore = [*PQSEC, "-k", str(folder / profile)]
        seconds([*keystore, "ca", "init", "--no-passphrase", "--profile", profile])
        seconds([*keystore, "issue", "/talker", "--publish", "chatter"])
        found[f"pqsec issue ({profile})"] = [*keystore, "issue", "NAME", "--publish", "chatter"]
    governance = str(folder / "pq/enclaves/governance.p7s")
    explain = ["explain", "--participant", "/talker", "--publish", "chatter"]
    found["pqsec status (pq)"] = [*PQSEC, "-k", str(folder / "pq"), "status"]
    found["pqsec explain (pq)"] = [*PQSEC, "-k", str(folder / "pq"), *explain]
    found["pqsec verify (pq)"] = [*PQSEC, "-k", str(folder / "pq"), "verify", governance]
    if sros2:
        seconds([sros2, "-c", SROS2_KEYSTORE, str(folder / "sros2")])
        found["SROS2's create_enclave"] = [sros2, "-c", SROS2, str(folder / "sros2"), "NAME"]
    return found


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--sros2", metavar="PYTHON")
    sros2 = options.parse_args().sros2
    taken: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        measured = commands(Path(folder), sros2)
        for number in range(ROUNDS):
            for name, command in measured.items():
                words = [f"/robot{number}" if word == "NAME" else word for word in command]
                taken.setdefault(name, []).append(seconds(words))
    medians = {name: statistics.median(times) for name, times in taken.items()}
    imports = medians["importing click, cryptography, jinja2, lxml, yaml"]
    other = medians.get("SROS2's create_enclave")
    print(f"{'':<50} {'ms':>7}  x imports{'  x SROS2' if other else ''}")
    for name, median in medians.items():
        compared = f"  {median / other:7.2f}" if other else ""
        print(f"{name:<50} {median * 1000:7.1f}  {median / imports:9.2f}{compared}")
    print("targets: --version 0.4 x imports; issue 1.0 x SROS2 (classical), 1.2 (pq)")


if __name__ == "__main__":
    main()
