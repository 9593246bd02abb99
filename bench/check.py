"""How long `pqsec check` takes on keystores of 125 to 1000 participants.

The floor of each row is to read all the files and parse all certificates and documents
once, which no check can do without. Run: python bench/check.py [PROFILE]
"""

import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet, validate
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.lint import Severity, check
from pqsec_pki.smime import document_in

SIZES = (125, 250, 500, 1_000)
NOW = datetime.now(UTC)
VALID = timedelta(days=365)
DOMAINS = DomainSet.of(0)


def main() -> None:
    profile = sys.argv[1] if len(sys.argv) > 1 else "transition"
    print(f"profile {profile}")
    print(f"{'members':>7} {'check s':>8} {'ms each':>8} {'x floor':>8} {'worse than info':>16}")
    with TemporaryDirectory() as folder:
        for size in SIZES:
            keystore(Path(folder, str(size)), profile, size)
            row(Path(folder, str(size)), size)
    print("target: linear (twice the members, twice the time), nothing worse than info")


def keystore(root: Path, profile: str, size: int) -> None:
    made = Keystore.create(
        root, profile_named(profile), name="Bench", domains=DOMAINS,
        validity=2 * VALID, passphrase=b"not a secret", now=NOW,
    )  # fmt: skip
    specs = [
        ParticipantSpec(
            name=f"/fleet/robot{n}", domains=DOMAINS, validity=VALID,
            publish=(f"rt/robot{n}/odom",), subscribe=(f"rt/robot{n}/cmd",),
        )
        for n in range(size)
    ]  # fmt: skip
    issue(made, made.unlock(b"not a secret"), specs, now=NOW)


def row(root: Path, size: int) -> None:
    taken, report = timed(lambda: check([root], now=NOW))
    floor, _ = timed(lambda: read_all(root))
    worse = [each for each in report.findings if each.rule.severity is not Severity.INFO]
    print(f"{size:7} {taken:8.2f} {taken / size * 1000:8.2f} {taken / floor:8.2f} {len(worse):16}")


def read_all(root: Path) -> None:
    for path in root.rglob("*"):
        data = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
        if path.name.endswith("cert.pem") and data:
            Certificate.from_pem(data)
        elif path.suffix == ".xml":
            validate(data)
        elif path.suffix == ".p7s" and data:
            validate(document_in(data))


def timed(work: Callable[[], object]) -> tuple[float, object]:
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result


if __name__ == "__main__":
    main()
