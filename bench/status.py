"""`pqsec status` of 10,000 participants, as a process, against its floor in the same run.

The participants are lines in the ledger and folders, as `pqsec issue` leaves them, but
without keys and signatures, which status never looks at. The floor is a process of the
same Python that imports click and sqlite3 and reads as many rows of the same database.
Each is the fastest of --rounds.
Run: python bench/status.py [--count 10000] [--rounds 5] [--folder DIR]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pqsec_pki.algorithms import DEFAULT_PROFILE
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Entry, Keystore, change

TARGET = 0.5
FLOOR = """
import sys, click, sqlite3
database = sqlite3.connect(sys.argv[1])
rows = database.execute("SELECT name, not_after, serial, details FROM ledger").fetchall()
print(len(rows))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--folder", help="where to make the keystore")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        root = Path(folder) / "k"
        populate(root, options.count)
        floor = fastest(options.rounds, "-c", FLOOR, root / "private/ledger.sqlite3")
        print(f"{options.count} participants; floor {floor:.3f} s")
        for words in (["status"], ["status", "--json"], ["needs-renewal"]):
            seconds = fastest(options.rounds, "-m", "pqsec_pki", "-k", root, *words)
            print(f"{' '.join(words):<16} {seconds:6.3f} s  {seconds / floor:5.2f} x floor")
    print(f"target: status of 10,000 <= {TARGET} s")


def populate(root: Path, count: int) -> None:
    now = datetime.now(UTC)
    keystore = Keystore.create(
        root,
        DEFAULT_PROFILE,
        name="Bench",
        domains=DomainSet.of(0),
        validity=timedelta(days=3650),
        passphrase=None,
        now=now,
    )
    issuer = keystore.identity_ca.fingerprint
    with change(root) as draft:
        draft.entries += (
            Entry(
                at=now.isoformat(timespec="seconds"),
                kind="participant",
                name=f"/fleet/robot{number}",
                serial=f"{number:040x}",
                sha256=f"{number:064x}",
                not_after=(now + timedelta(days=1 + number % 700)).isoformat(),
                issuer=issuer,
                details={"profile": "transition", "domains": "0"},
                operator="bench",
            )
            for number in range(count)
        )
    for number in range(count):
        os.makedirs(f"{root}/enclaves/fleet/robot{number}")
        Path(f"{root}/enclaves/fleet/robot{number}/cert.pem").touch()


def fastest(rounds: int, *arguments: object) -> float:
    """Wall seconds of that Python process; needs-renewal ends in 0 or 1."""
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        command = [sys.executable, *map(str, arguments)]
        subprocess.run(command, check=False, stdout=subprocess.DEVNULL)
        taken.append(time.perf_counter() - start)
    return min(taken)


if __name__ == "__main__":
    main()
