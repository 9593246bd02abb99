"""Programs that tests compile: kept for the next run, and for the workers of this one."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.trial.building import cache, compiling_once


def kept(name: str, inputs: object, make: Callable[[Path], object]) -> Path:
    """The folder that `make` fills, or has filled before with the same inputs.

    It is beside what `pqsec try` compiles. Inputs are all that the result depends on, for `repr`.
    """
    goal = cache() / f"for-tests-{name}-{hashlib.sha256(repr(inputs).encode()).hexdigest()[:16]}"
    with compiling_once(goal) as missing:
        if missing:
            with TemporaryDirectory(dir=goal.parent) as folder:
                made = Path(folder, "made")
                made.mkdir()
                make(made)
                made.rename(goal)
    return goal


def contents(*paths: Path) -> list[tuple[str, bytes]]:
    """The names and octets of files: inputs."""
    return [(path.name, path.read_bytes()) for path in sorted(paths)]
