"""Programs that tests compile: kept for the next run, and for the workers of this one."""

import fcntl
import hashlib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.trial.building import cache


def kept(name: str, inputs: object, make: Callable[[Path], object]) -> Path:
    """The folder that `make` fills, or has filled before with the same inputs.

    It is beside what `pqsec try` compiles. Inputs are all that the result depends on, for `repr`.
    Who needs it while another worker makes it waits.
    """
    goal = cache() / f"for-tests-{name}-{hashlib.sha256(repr(inputs).encode()).hexdigest()[:16]}"
    with goal.with_name(f".{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not goal.exists():
            with TemporaryDirectory(dir=goal.parent) as folder:
                made = Path(folder, "made")
                made.mkdir()
                make(made)
                made.rename(goal)
    return goal


def contents(*paths: Path) -> list[tuple[str, bytes]]:
    """The names and octets of files: inputs."""
    return [(path.name, path.read_bytes()) for path in sorted(paths)]
