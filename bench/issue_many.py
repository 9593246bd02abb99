"""1000 participants issued in one call, then renewed, against the raw primitives in the same run.

The raw primitives of a participant are its key generations and the signatures that its
certificate and its permissions need: the same algorithms on data of the same size, in
one thread, nothing else. They are measured before and after, and averaged. The second
floor adds plain file system calls: the same number of folders, files and links. Then all
are renewed, with new keys: that reads and verifies the old permissions too. Each profile
runs in a process of its own, whose peak memory is shown.
Run: python bench/issue_many.py [--count 1000] [--folder DIR] [PROFILE...]
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

PROFILES = ("classical", "transition", "pq")
CERTIFICATE, DOCUMENT = bytes(2000), bytes(200)
"""About what a signature of each kind covers."""
FILES, LINKS = 4, 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("profiles", nargs="*", default=PROFILES)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--folder", help="where to make keystores; its file system matters")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(measure(options.profiles[0], options.count, Path(options.folder))))
        return
    print(f"{len(os.sched_getaffinity(0))} cores; raw is what one of them takes")
    heads = (
        "profile",
        "wall s",
        "raw s",
        "x raw",
        "raw+files s",
        "x",
        "renewed s",
        "x",
        "peak MiB",
    )
    print("{:<12} {:>8} {:>8} {:>6} {:>12} {:>6} {:>9} {:>6} {:>9}".format(*heads))
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        for profile in options.profiles:
            command = [sys.executable, __file__, "--child", "--folder", folder, profile]
            command += ["--count", str(options.count)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            show(profile, **json.loads(done.stdout))
    print("targets: pq <= 1.5 x raw, peak <= 60 MiB")


def show(  # noqa: PLR0913 -- the columns
    profile: str, *, wall: float, renewed: float, raw: float, files: float, peak: float
) -> None:
    floor = raw + files
    print(
        f"{profile:<12} {wall:8.2f} {raw:8.2f} {wall / raw:6.2f}"
        f" {floor:12.2f} {wall / floor:6.2f} {renewed:9.2f} {renewed / floor:6.2f} {peak:9.1f}"
    )


def measure(name: str, count: int, folder: Path) -> dict[str, float]:
    from pqsec_pki.algorithms import profile_named
    from pqsec_pki.documents import DomainSet
    from pqsec_pki.keystore import Keystore
    from pqsec_pki.lifecycle import ParticipantSpec, issue, renew

    now, year = datetime.now(UTC), timedelta(days=365)
    domains = DomainSet.of(0)
    root = folder / name
    keystore = Keystore.create(
        root,
        profile_named(name),
        name="Bench",
        domains=domains,
        validity=10 * year,
        passphrase=None,
        now=now,
    )
    authorities = keystore.unlock(None)
    specs = [
        ParticipantSpec(
            name=f"/fleet/robot{number}",
            domains=domains,
            publish=("rt/chatter",),
            subscribe=("rt/cmd",),
            validity=year,
        )
        for number in range(count)
    ]
    before = primitives(keystore.profile, authorities, count // 2)
    start = time.perf_counter()
    issue(keystore, authorities, specs, now=now)
    wall = time.perf_counter() - start
    start = time.perf_counter()
    renew(keystore, authorities, [spec.name for spec in specs], now=now)
    renewed = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    raw = before + primitives(keystore.profile, authorities, count - count // 2)
    return {
        "wall": wall,
        "renewed": renewed,
        "raw": raw,
        "files": file_calls(folder / f"{name}-files", count),
        "peak": peak,
    }


def primitives(profile, authorities, count: int) -> float:
    """Seconds for the key generations and signatures of `count` participants."""
    kinds = [kind for kind in (profile.participant_key, profile.alternative_key) if kind]
    identity = authorities.identity
    issuers = [key for key in (identity.key, identity.alternative_key) if key]
    signers = [each.key for each in (authorities.permissions, authorities.countersigner) if each]
    start = time.perf_counter()
    for _ in range(count):
        for kind in kinds:
            kind.generate_handle()
        for key in issuers:
            key.sign(CERTIFICATE)
        for key in signers:
            key.sign(DOCUMENT)
    return time.perf_counter() - start


def file_calls(folder: Path, count: int) -> float:
    """Seconds for the folders, files and links of `count` participants."""
    folder.mkdir()
    data = bytes(3000)
    start = time.perf_counter()
    for number in range(count):
        path = f"{folder}/{number}"
        os.mkdir(path)
        for file in range(FILES):
            handle = os.open(f"{path}/{file}", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            os.write(handle, data)
            os.close(handle)
        for link in range(LINKS):
            os.symlink("../target", f"{path}/link{link}")
    os.sync()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
