"""Changes per second of a ledger in PostgreSQL, beside the file, in the same run.

Writers are processes that each make --count changes of one line: on one keystore with the file, and
on two keystores (machines) with one ledger in a server of its own, by a Unix socket. A change is
what a command makes: it reads the ledger, adds a line, and is synced to the disk. Then a ledger of
--lines lines is read by each. The server runs as tests/postgres.py starts it, but with fsync.
Run: python bench/ledger.py [--count 25] [--lines 20000] [--folder DIR]
"""

import argparse
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has the other side

from pqsec_pki.keystore import Entry, Keystore, change
from tests.interop.shared_ledger import copied, create
from tests.postgres import Cluster

WRITERS = (1, 2, 8)
WRITER = """
import sys
from pathlib import Path
from bench.ledger import write
root, name, count = sys.argv[1:]
write(Path(root), name, int(count))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=25)
    parser.add_argument("--lines", type=int, default=20_000)
    parser.add_argument("--folder", help="where to make the keystores")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder, Cluster.created() as cluster:
        cluster.stop("fast")
        cluster.start(fsync="on")
        file = create(Path(folder, "file"))
        first = create(Path(folder, "first"), cluster.address(cluster.database()))
        second = copied(first, Path(folder, "second"))
        kinds = {"file": [file], "PostgreSQL": [first, second]}
        for kind, machines in kinds.items():
            for writers in WRITERS:
                rate = changes(machines, writers, options.count)
                print(f"{kind:<10} {writers} writers  {rate:6.1f} changes/s")
        for kind, [keystore, *_] in kinds.items():
            fill(keystore, options.lines)
            print(f"{kind:<10} {len(keystore.lines())} lines  {reading(keystore):6.3f} s to read")


def changes(machines: list[Keystore], writers: int, count: int) -> float:
    """Of these writers, per second; the time is without the start of the processes."""
    before = time.monotonic()
    commands = [
        subprocess.Popen(
            [sys.executable, "-c", WRITER, machines[each % len(machines)].root,
             f"w{writers}-{each}", str(count)], stdout=subprocess.PIPE, text=True
        )
        for each in range(writers)
    ]  # fmt: skip
    begun = [float(each.communicate()[0]) for each in commands]
    return writers * count / (time.monotonic() - max(before, min(begun)))


def write(root: Path, name: str, count: int) -> None:
    print(time.monotonic())
    for number in range(count):
        with change(root) as transaction:
            transaction.record(line(f"/{name}/{number}"))


def fill(keystore: Keystore, count: int) -> None:
    with change(keystore.root) as transaction:
        transaction.record(*(line(f"/many/{number}") for number in range(count)))


def line(name: str) -> Entry:
    at = datetime.now(UTC).isoformat(timespec="seconds")
    return Entry(at, "receipt", name, None, name.encode().hex(), None)


def reading(keystore: Keystore) -> float:
    before = time.monotonic()
    with keystore.open_ledger():
        return time.monotonic() - before


if __name__ == "__main__":
    main()
