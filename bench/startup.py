"""How long one command takes as a whole process, against its imports and against SROS2.

Whole processes, run in turn so that a drift of the machine's speed hits all alike; medians of the
processor's time. With --instructions, valgrind counts the instructions of one run each instead, in
millions: other work on the machine does not change them. Modules are compiled before, as an
installation does it, also where PYTHONDONTWRITEBYTECODE is set. Run:

    python bench/startup.py [--instructions] [--sros2 PYTHON]

PYTHON is an interpreter that can import sros2, such as python3 after `source setup.bash` of ROS 2;
SROS2 then makes an enclave by the function behind `ros2 security create_enclave`.
"""

import argparse
import compileall
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROUNDS = 15
PQSEC = [sys.executable, "-m", "pqsec_pki"]
IMPORTS = "import click, cryptography.x509, jinja2, lxml.etree, yaml"
LIBRARIES = "import gc; gc.disable(); import cryptography.x509, lxml.etree"
AGENT = "import gc; gc.disable(); import pqsec_pki.plugin.__main__"
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
VALGRIND = (
    "valgrind --trace-children=yes --tool=cachegrind --cache-sim=no --cachegrind-out-file=/dev/null"
)
PACKAGE = Path(__file__).parents[1] / "pqsec_pki"
PROFILES = ("classical", "pq", "transition")


def seconds(command: list[str]) -> float:
    """Of the processor, in that process and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def instructions(command: list[str]) -> float:
    """Millions, in that process and its children."""
    line = [*VALGRIND.split(), *command]
    done = subprocess.run(line, check=True, capture_output=True, text=True)
    found: list[str] = re.findall(r"I +refs: +([0-9,]+)", done.stderr)
    return sum(int(each.replace(",", "")) for each in found) / 1e6


def commands(folder: Path, sros2: str | None) -> dict[str, list[str]]:
    """Name -> a command, in which NAME is another participant each time."""
    found = {
        "bare Python": [sys.executable, "-c", "pass"],
        "importing click, cryptography, jinja2, lxml, yaml": [sys.executable, "-c", IMPORTS],
        "importing cryptography, lxml": [sys.executable, "-c", LIBRARIES],
        "importing pqsec's agent": [sys.executable, "-c", AGENT],
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
    options.add_argument("--instructions", action="store_true")
    options.add_argument("--sros2", metavar="PYTHON")
    chosen = options.parse_args()
    measure, rounds = (instructions, 1) if chosen.instructions else (seconds, ROUNDS)
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    compileall.compile_dir(PACKAGE, quiet=1)
    taken: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        measured = commands(Path(folder), chosen.sros2)
        for number in range(rounds):
            for name, command in measured.items():
                words = [f"/robot{number}" if word == "NAME" else word for word in command]
                taken.setdefault(name, []).append(measure(words))
    medians = {name: statistics.median(times) for name, times in taken.items()}
    imports = medians["importing click, cryptography, jinja2, lxml, yaml"]
    other = medians.get("SROS2's create_enclave")
    unit, scale = ("millions", 1) if chosen.instructions else ("ms", 1000)
    print(f"{'':<50} {unit:>8}  x imports{'  x SROS2' if other else ''}")
    for name, median in medians.items():
        compared = f"  {median / other:7.2f}" if other else ""
        print(f"{name:<50} {median * scale:8.1f}  {median / imports:9.2f}{compared}")
    print("targets: --version 0.4 x imports; issue 1.0 x SROS2 (classical), 1.2 (pq)")


if __name__ == "__main__":
    main()
