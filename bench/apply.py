"""`pqsec apply` of new participants, and of none, as processes, against floors in the same run.

New ones, for each profile: `raw` is the time of a processor for their key generations and
signatures as raw calls, `files` that for as many folders, files and links as plain system
calls. The floor is both, shared by the cores. On a busy machine the last ratio counts more:
all processor time of the process, that of its start included, against raw and files.

None: apply to a keystore that has --many already, as the file wants it; the floor is a
process of the same Python that imports click, sqlite3 and yaml, reads as many rows and
asks for two files' stamps for each. Peaks are of the whole process.
Run: python bench/apply.py [--count 1000] [--many 10000] [--folder DIR] [PROFILE...]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from issue_many import file_calls, primitives

from pqsec_pki.algorithms import profile_named
from pqsec_pki.keystore import Authorities

PROFILES = ("classical", "transition", "pq")
CORES = len(os.sched_getaffinity(0))
DOMAIN = """
profile: {profile}
roles:
  robot: {{publish: [rt$name/pose], subscribe: [rt/fleet/command]}}
participants:
  - name: /fleet/robot{{00001..{count:05}}}
    role: robot
"""
FLOOR = """
import os, sys, click, sqlite3, yaml
root, sql = sys.argv[1], "SELECT name, sha256, at, not_after, details FROM ledger WHERE kind = ?"
database = sqlite3.connect(f"{root}/private/ledger.sqlite3")
for kind, file in ("participant", "cert.pem"), ("permissions", "permissions.p7s"):
    for name, *_ in database.execute(sql, (kind,)).fetchall():
        os.lstat(f"{root}/enclaves{name}/{file}")
"""
ROUNDS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("profiles", nargs="*", default=PROFILES)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--many", type=int, default=10_000)
    parser.add_argument("--folder", help="where to make keystores; its file system matters")
    options = parser.parse_args()
    print(f"{CORES} cores")
    head = ("profile", "wall s", "cpu s", "raw s", "files s", "x floor", "x cpu", "peak MiB")
    print("{:<12} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>9}".format(*head))
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        for profile in options.profiles:
            measure_new(Path(folder), profile, options.count)
        measure_none(Path(folder), options.many)
    print("targets: pq <= 1.3 x floor; a no-op of 10,000 <= 1 s; peak <= 80 MiB")


def measure_new(folder: Path, profile: str, count: int) -> None:
    raw = raw_seconds(profile, count // 2)
    wall, cpu, peak = fastest(1, *apply_in(folder / profile, profile, count))
    raw += raw_seconds(profile, count - count // 2)
    start = time.process_time()
    file_calls(folder / f"{profile}-files", count)
    files = time.process_time() - start
    floor = raw + files
    print(
        f"{profile:<12} {wall:8.2f} {cpu:8.2f} {raw:8.2f} {files:8.2f}"
        f" {wall / floor * CORES:8.2f} {cpu / floor:8.2f} {peak:9.1f}"
    )


def measure_none(folder: Path, many: int) -> None:
    command = apply_in(folder / "many", "classical", many)
    wall, cpu, peak = fastest(1, *command)
    print(f"{many} new classical: {wall:.2f} s, of the processor {cpu:.2f} s, {peak:.1f} MiB")
    fastest(1, *command)  # has a look at all files
    wall, cpu, peak = fastest(ROUNDS, *command)
    floor, floor_cpu, _ = fastest(ROUNDS, "-c", FLOOR, folder / "many/k")
    ratios = f"{wall / floor:.2f} x floor, of the processor {cpu / floor_cpu:.2f} x"
    print(f"{many} as they are: {wall:.2f} s, {ratios}, {peak:.1f} MiB")


def apply_in(folder: Path, profile: str, count: int) -> list[object]:
    """The command, with its file; the keystore will be beside it."""
    folder.mkdir()
    file = folder / "domain.yaml"
    file.write_text(DOMAIN.format(profile=profile, count=count))
    words = ["-m", "pqsec_pki", "-k", folder / "k", "apply", file, "--yes", "--no-passphrase"]
    return list(words)


def raw_seconds(name: str, count: int) -> float:
    """Of a processor, for what `count` participants need of the algorithms."""
    profile, now = profile_named(name), datetime.now(UTC)
    authorities = Authorities.create(profile, "Bench", now=now, validity=timedelta(days=365))
    start = time.process_time()
    primitives(profile, authorities, count)
    return time.process_time() - start


def fastest(rounds: int, *arguments: object) -> tuple[float, float, float]:
    """Wall seconds, processor seconds and peak MiB of that Python process."""
    return min(run(*arguments) for _ in range(rounds))


def run(*arguments: object) -> tuple[float, float, float]:
    start = time.perf_counter()
    command = [sys.executable, *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"exit {process.returncode}: {' '.join(command)}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


if __name__ == "__main__":
    main()
