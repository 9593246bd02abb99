"""What the gate leaves to the longer job."""

import os
import re
import subprocess
import sys
import tomllib

import pytest

from tests.longer import TESTS, covering, spread
from tests.measured import LIST
from tests.unmeasured import unmeasured, worth_measuring

LEFT_OUT = tomllib.loads((TESTS / "longer.toml").read_text())
TOY = """
import pytest

@pytest.mark.parametrize("profile", ["classical", "transition", "pq"])
@pytest.mark.parametrize(("stack", "version"), [("cyclonedds", 1), ("fastdds", 2)])
def test_matrix(stack, version, profile):
    assert profile != "pq"

@pytest.mark.parametrize("number", range(5))
def test_table(number):
    pass

def test_one():
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


def test_what_is_left_out_is_there():
    texts = {file: (TESTS / file).read_text() for file in LEFT_OUT}
    missing = [
        f"{file}: {name}"
        for file, names in LEFT_OUT.items()
        for name in names
        if f"\ndef {name}(" not in texts[file]
    ]
    assert missing == []


def test_what_is_not_measured_is_there():
    """Each line of unmeasured.txt names a file, or a test, that exists."""
    names = [line.partition("::") for line in LIST.read_text().splitlines()]
    files = {file for file, _, _ in names}
    words = {file: {"", *re.findall(r"\w+", (TESTS.parent / file).read_text())} for file in files}
    assert [name for file, _, name in names if name not in words[file]] == []


def test_what_others_show_is_not_measured():
    """Of two tests that show the same, the quicker one; a file without a chosen one as a whole."""
    seconds = {"a::slow": 9, "a::quick": 0.01, "a::other": 0.1, "b::none": 0.1, "b::same": 2}
    points = {
        "a::slow": {(1, 1), (1, 2)},
        "a::quick": {(1, 1), (1, 2)},
        "a::other": {(1, line) for line in range(3, 9)},
        "b::same": {(1, 1)},
    }
    chosen = worth_measuring(seconds, points)
    assert chosen == {"a::quick", "a::other"}
    assert unmeasured(seconds, chosen) == ["a::slow", "b"]


@pytest.fixture
def toy(tmp_path):
    """toy(PQSEC_LONG, options) is what pytest says of a file of tests, with our conftest."""
    folder = tmp_path / "tests"
    folder.mkdir()
    for name in ("conftest.py", "longer.py", "libraries.py", "measured.py"):
        (folder / name).symlink_to(TESTS / name)
    (folder / "longer.toml").write_text('["test_toy.py"]\ntest_table = ["1", "4"]\n')
    (folder / "test_toy.py").write_text(TOY)

    def run(long, *options):
        environment = {name: os.environ[name] for name in os.environ if name[:6] != "PYTEST"}
        done = subprocess.run(
            [
                *(sys.executable, "-m", "pytest", "-c", TESTS.parent / "pyproject.toml"),
                *("--rootdir", tmp_path, "-p", "no:cacheprovider", "-q", *options),
            ],
            cwd=tmp_path,
            env=environment | {"PQSEC_LONG": long},
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout + done.stderr

    return run


@pytest.mark.slow
def test_the_gate_runs_a_part_and_the_longer_job_all(toy):
    gate = toy("", "tests")
    assert "1 failed, 6 passed, 5 deselected" in gate
    for long in ("1", "cases"):
        assert "2 failed, 10 passed" in toy(long, "tests")


@pytest.mark.slow
def test_what_is_named_runs_and_of_files_beside_it_a_part(toy, tmp_path):
    (tmp_path / "tests" / "test_other.py").write_text(TOY)
    said = toy("", "tests/test_toy.py::test_table[1]", "tests/test_other.py")
    assert "1 failed, 9 passed, 3 deselected" in said


@pytest.mark.slow
def test_a_case_that_there_is_not_cannot_be_left_out(toy, tmp_path):
    (tmp_path / "tests" / "longer.toml").write_text('["test_toy.py"]\ntest_table = ["7"]\n')
    assert "test_table has no case ['7']" in toy("", "tests")
