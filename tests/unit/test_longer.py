"""What the gate leaves to the longer job."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.longer import covering, spread

TESTS = Path(__file__).parents[1]
TOY = """
import pytest

@pytest.mark.parametrize("profile", ["classical", "transition", "pq"])
@pytest.mark.parametrize(("stack", "version"), [("cyclonedds", 1), ("fastdds", 2)])
def test_matrix(stack, version, profile):
    assert profile != "pq"

@pytest.mark.slow(but=2)
@pytest.mark.parametrize("number", range(5))
def test_table(number):
    pass

@pytest.mark.parametrize("size", [1, pytest.param(9, marks=pytest.mark.slow)])
def test_sizes(size):
    pass

@pytest.mark.slow
def test_slow():
    pytest.skip("in .ci/long: a stack")

class TestClass:
    def test_one(self):
        pass
"""


def test_few_cases_have_each_value():
    both = [(("who", who), ("what", what)) for who in "abc" for what in range(5)]
    chosen = covering(both)
    assert len(chosen) == 5
    assert {value for number in chosen for value in both[number]} == set(sum(both, ()))
    assert covering([("a",), ("b",), ("c",)]) == [0, 1, 2]
    assert covering([()]) == [0]


def test_cases_are_spread_evenly():
    assert spread(range(10), 2) == [0, 5]
    assert spread(range(3), 5) == [0, 1, 2]
    assert spread(range(3), 0) == []


@pytest.fixture
def toy(tmp_path):
    """toy(options, **variables) is what pytest says of a file of tests, with our conftest."""
    folder = tmp_path / "tests"
    folder.mkdir()
    for name in ("conftest.py", "longer.py", "libraries.py"):
        (folder / name).symlink_to(TESTS / name)
    (folder / "test_toy.py").write_text(TOY)

    def run(*options, **variables):
        kept = {n: v for n, v in os.environ.items() if not n.startswith(("PYTEST", "PQSEC_"))}
        done = subprocess.run(
            [
                *(sys.executable, "-m", "pytest", "-c", TESTS.parent / "pyproject.toml"),
                *("--rootdir", tmp_path, "-p", "no:cacheprovider", "-q", *options),
            ],
            cwd=tmp_path,
            env=kept | variables,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout + done.stderr

    return run


def test_the_gate_runs_what_is_not_slow_and_the_longer_job_all(toy):
    assert "1 failed, 6 passed, 8 deselected" in toy("tests")
    for long in ("1", "cases"):
        assert "2 failed, 12 passed, 1 skipped" in toy("tests", PQSEC_LONG=long)


def test_what_is_named_runs_and_of_files_beside_it_a_part(toy, tmp_path):
    (tmp_path / "tests" / "test_other.py").write_text(TOY)
    file = "tests/test_toy.py::"
    named = (f"{file}test_table[1]", f"{file}test_slow", f"{file}TestClass")
    assert "1 failed, 8 passed, 1 skipped, 8 deselected" in toy(*named, "tests/test_other.py")
    assert "3 passed" in toy(f"{file}test_table[1]", f"{file}test_sizes", PQSEC_PART="2/2")


def test_each_case_is_in_one_part(toy):
    parts = [
        toy("--collect-only", "tests", PQSEC_LONG="cases", PQSEC_PART=f"{number}/4")
        for number in range(1, 5)
    ]
    cases = [
        [line for line in part.splitlines() if line.startswith("tests/test_toy.py::")]
        for part in parts
    ]
    assert sorted(map(len, cases)) == [3, 4, 4, 4]
    assert len({case for part in cases for case in part}) == 15


def test_what_is_skipped_is_noted_or_fails(toy, tmp_path):
    """The gate notes it on the bare machine, and fails where all other implementations are."""
    file = "tests/test_toy.py"
    (tmp_path / file).write_text("import pytest\ndef test_it(): pytest.skip('no compiler')\n")
    assert "1 skipped" in toy("tests", "-n", "2", PQSEC_SKIPPED=str(tmp_path / "skipped"))
    assert (tmp_path / "skipped").read_text() == f"{file}::test_it\n"
    assert "1 failed" in toy("tests", PQSEC_REQUIRE_INTEROP="1")
    assert "1 skipped" in toy(f"@{tmp_path}/skipped", PQSEC_SKIPPED="", PQSEC_REQUIRE_INTEROP="")
