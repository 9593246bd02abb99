"""`pqsec` in the process of the tests, through the same `main` as the shell."""

import os
import sys
from collections.abc import Mapping, Sequence
from io import BytesIO, TextIOWrapper
from pathlib import Path

import pytest
from coverage import Coverage

from pqsec_pki.cli import main

ROOT = Path(__file__).parents[1]


def clean_environment(**extra: str) -> dict[str, str]:
    """The environment, less what pqsec listens to; streams are buffered, as Python does it."""
    dropped = ("PQSEC_", "ROS_SECURITY_", "PYTHONUNBUFFERED")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(dropped)}
    return {**kept, "NO_COLOR": "1", **extra}  # test_terminal.py is about colours


def run_here(
    words: Sequence[str], *, cwd: Path, env: Mapping[str, str]
) -> tuple[int | str | None, str, str]:
    """Run a command line with these variables: its exit code and what it said on two streams."""
    out, err = BytesIO(), BytesIO()
    with pytest.MonkeyPatch.context() as patch, Path(os.devnull).open() as nothing:
        patch.chdir(cwd)
        for name in set(os.environ) - set(env):
            patch.delenv(name)
        for name, value in env.items():
            patch.setenv(name, value)
        patch.setattr(sys, "argv", ["pqsec", *words])
        patch.setattr(sys, "warnoptions", ["error"])  # else main hides warnings from us
        patch.setattr(sys, "stdin", nothing)
        patch.setattr(sys, "stdout", TextIOWrapper(out, "utf-8", write_through=True))
        patch.setattr(sys, "stderr", TextIOWrapper(err, "utf-8", write_through=True))
        mask = os.umask(0o022)
        os.umask(mask)
        try:
            with pytest.raises(SystemExit) as end:
                main()
        finally:
            os.umask(mask)
        return end.value.code, out.getvalue().decode(), err.getvalue().decode()


def measured_too() -> dict[str, str]:
    """Variables with which the coverage of a process is measured; none if that of tests is not."""
    if Coverage.current() is None:
        return {}
    return {
        "COVERAGE_PROCESS_START": str(ROOT / "tests/processes.coveragerc"),
        "COVERAGE_FILE": str(ROOT / ".coverage"),
    }
