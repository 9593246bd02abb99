"""What .ci/run and .ci/long do with tests that fail."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CI = Path(__file__).parents[2] / ".ci"
TWICE = """
from pathlib import Path

def fails_at_first(name):
    ran = Path(__file__).with_name(name)
    assert ran.exists() or ran.touch(), f"the message of {name}"
"""
STAGE = """\
. .ci/stages
tests() { tested here "$PYTHON" '"$PYTHON" -m pytest -q'; }
run "toy tests" tests
"""


@pytest.fixture
def stage(tmp_path):
    """stage(text) is what a stage of these tests says, as the gate would."""
    (tmp_path / ".ci").symlink_to(CI)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")

    def run(text):
        (tmp_path / "test_toy.py").write_text(TWICE + text)
        kept = {n: v for n, v in os.environ.items() if not n.startswith(("PYTEST", "PQSEC_"))}
        return subprocess.run(
            ["bash", "-euo", "pipefail", "-c", STAGE],
            cwd=tmp_path,
            env=kept | {"PYTHON": sys.executable},
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_what_passed_only_when_run_again_is_the_last_line(stage):
    flakes = "".join(
        f"def test_{name}(): fails_at_first('{name}')\n" for name in ("one", "two", "three")
    )
    done = stage(f"{flakes}def test_good(): pass\n")
    assert done.returncode == 0, done.stdout
    assert "the message of two" in done.stdout
    assert "3 failed, 1 passed" in done.stdout
    names = " ".join(f"test_toy.py::test_{name}" for name in ("one", "two", "three"))
    assert set(
        done.stdout.splitlines()[-1].removeprefix("passed only when run again: ").split()
    ) == set(names.split())
    assert "FAILED" not in done.stderr


def test_what_fails_twice_fails(stage):
    done = stage("def test_it(): assert False\ndef test_flake(): fails_at_first('flake')\n")
    assert done.returncode == 1
    assert "FAILED in stage toy tests" in done.stderr
    assert "passed only when run again" not in done.stdout


def test_more_than_three_failures_are_not_run_again(stage):
    names = ("one", "two", "three", "four")
    done = stage("".join(f"def test_{name}(): fails_at_first('{name}')\n" for name in names))
    assert done.returncode == 1
    assert "again" not in done.stdout


def test_each_part_of_the_longer_job_has_a_name_and_a_number():
    def longer(*words):
        return subprocess.run(
            ["bash", CI / "long", *words], capture_output=True, text=True, check=False
        )

    listed = [line.split() for line in longer("--list").stdout.splitlines()]
    assert [int(number) for number, _ in listed] == list(range(1, len(listed) + 1))
    names = [name for _, name in listed]
    assert len(set(names)) == len(names)
    script = (CI / "long").read_text()
    assert {name.partition("/")[0] for name in names} <= {
        line.partition("(")[0] for line in script.splitlines() if "() {" in line
    }
    turn, of, count, *_ = longer("--turn").stdout.split() or ["1", "of", str(len(listed))]
    assert (1 <= int(turn) <= len(listed), of, count) == (True, "of", str(len(listed)))
    for wrong in ("fuzz/0", "nothing", str(len(listed) + 1), "0"):
        done = longer(wrong)
        assert (done.returncode, f"no part {wrong}: " in done.stderr) == (2, True), done
