"""How long `pqsec --version` and one `pqsec issue` take, against what they stand on.

Whole processes, run in turn so that a drift of the machine's speed hits all alike;
medians. Run: python bench/startup.py
"""

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROUNDS = 15
PQSEC = [sys.executable, "-m", "pqsec_pki"]
IMPORTS = "import click, cryptography.x509, jinja2, lxml.etree, yaml"


def seconds(command: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - start


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        keystore = str(Path(folder, "ks"))
        create = [*PQSEC, "-k", keystore, "ca", "init", "--no-passphrase"]
        subprocess.run(create, check=True, capture_output=True)
        commands = {
            "bare Python": [sys.executable, "-c", "pass"],
            "importing click, cryptography, jinja2, lxml, yaml": [sys.executable, "-c", IMPORTS],
            "pqsec --version": [*PQSEC, "--version"],
            "pqsec --help": [*PQSEC, "--help"],
            "pqsec issue (transition)": [*PQSEC, "-k", keystore, "issue", "NAME"],
        }
        taken: dict[str, list[float]] = {name: [] for name in commands}
        for number in range(ROUNDS):
            for name, command in commands.items():
                words = [f"/robot{number}" if word == "NAME" else word for word in command]
                taken[name].append(seconds(words))
    medians = {name: statistics.median(times) for name, times in taken.items()}
    imports = medians["importing click, cryptography, jinja2, lxml, yaml"]
    print(f"{'':<50} {'ms':>7}  x imports")
    for name, median in medians.items():
        print(f"{name:<50} {median * 1000:7.1f}  {median / imports:.2f}")
    print("target: pqsec --version <= 0.6 x imports")


if __name__ == "__main__":
    main()
