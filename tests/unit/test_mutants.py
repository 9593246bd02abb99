"""The job that breaks conditions says the truth: on a toy of one module and one test."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.mutants.__main__ import TESTS, paths, unjudged
from tests.mutants.conditions import PACKAGE, ROOMS, mutants

ROOT = Path(__file__).resolve().parents[2]

DOOR = '''\
"""A door."""

LIMIT = 3


def enter(count):
    """Raise ValueError for more than LIMIT."""
    if count > LIMIT:
        raise ValueError(count)
    return count
'''
TESTED = """\
import pytest
from pqsec_pki.access.door import enter


def test_one_enters():
    assert enter(1) == 1
"""
REFUSED = """

def test_four_do_not():
    with pytest.raises(ValueError, match="4"):
        enter(4)
"""


LEFT_OPEN = """

import socket


def test_four_do_not():
    held = {each: socket.socket() for each in ("one", "other")}
    held["itself"] = held  # only the collector of cycles finds them
    with pytest.raises(ValueError, match="4"):
        enter(4)
    held["one"].close(), held["other"].close()
"""


STARTED = """\
import subprocess
import sys

WORDS = "from pqsec_pki.access.door import enter; print(enter({}))"


def said(count):
    done = subprocess.run([sys.executable, "-I", "-c", WORDS.format(count)], capture_output=True)
    return done.stdout


def test_one_enters_elsewhere():
    assert (said(1), said(4)) == (b"1\\n", b"")
"""


@pytest.fixture
def toy(tmp_path):
    """toy(tests) is a checkout with that door and those tests."""

    def make(tests):
        for path, text in {
            f"{PACKAGE}/__init__.py": "",
            f"{PACKAGE}/access/__init__.py": "",
            f"{PACKAGE}/access/door.py": DOOR,
            "tests/unit/test_access.py": tests,
            "tests/mutants/survivors.toml": "",
            "pyproject.toml": (ROOT / "pyproject.toml").read_text(),
        }.items():
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text)
        return tmp_path

    return make


def outcome(root):
    """The exit code, and of each kind of mutant what came of it."""
    results = root / "results.json"
    command = [sys.executable, "-m", "tests.mutants", "--root", root, "--json", results]
    done = subprocess.run(
        [*command, "--room", "access"],
        cwd=ROOT,
        env=os.environ | {"PYTEST_ADDOPTS": "--cov-fail-under=100"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert results.exists(), done.stdout + done.stderr
    found = json.loads(results.read_text())["results"]
    return done.returncode, {key.rpartition(":")[2]: result for key, result in found.items()}


@pytest.mark.slow
def test_a_mutant_survives_without_its_test_and_fails_the_job(toy):
    root = toy(TESTED)
    survivors = {"never": "survived", "boundary-1": "survived"}

    assert outcome(root) == (1, {"always": "killed"} | survivors)
    assert (root / PACKAGE / "access/door.py").read_text() == DOOR


@pytest.mark.slow
def test_survivors_that_are_known_and_not_judged_yet_do_not_fail_the_job_and_others_do(toy):
    root = toy(TESTED)
    known = [each.id for each in mutants(root)]
    (root / "tests/mutants/unjudged.txt").write_text("\n".join(known))
    assert outcome(root)[0] == 0

    (root / "tests/mutants/unjudged.txt").write_text("\n".join(known[:-1]))
    assert outcome(root)[0] == 1


@pytest.mark.slow
def test_a_mutant_is_killed_by_its_test_and_a_survivor_may_have_a_reason(toy):
    root = toy(TESTED + REFUSED)
    [boundary] = [each.id for each in mutants(root) if each.kind == "boundary-1"]
    (root / "tests/mutants/survivors.toml").write_text(f'"{boundary}" = "A toy."\n')

    killed = {"always": "killed", "never": "killed"}
    assert outcome(root) == (0, killed | {"boundary-1": "survived"})


@pytest.mark.slow
def test_what_a_failed_test_left_open_does_not_end_the_job(toy):
    """pytest raises it as an error when it has ended: then no test looked as if it could run."""
    assert outcome(toy(TESTED + LEFT_OPEN))[1]["never"] == "killed"


@pytest.mark.slow
def test_a_mutant_that_runs_only_in_a_program_that_a_test_starts_is_killed_by_that_test(toy):
    kinds = {"always": "killed", "never": "killed", "boundary-1": "survived"}
    assert outcome(toy(STARTED)) == (1, kinds)


def test_no_room_is_tried_with_tests_that_have_another_name_now():
    assert set(TESTS) == set(ROOMS)
    patterns = [each for patterns in TESTS.values() for each in patterns]
    assert [each for each in patterns if not paths(ROOT, each)] == []


def test_each_room_has_its_mutants_and_each_reason_is_for_one_of_them():
    found = mutants(ROOT)
    ids = {each.id for each in found}
    assert len(ids) == len(found) >= 300
    assert {each.room for each in found} == set(ROOMS)
    reasons = tomllib.loads((ROOT / "tests/mutants/survivors.toml").read_text())
    assert set(reasons) <= ids
    assert unjudged(ROOT) <= ids - set(reasons)
    for each in found[::100]:  # `.ci/long mutants` applies all
        source = (ROOT / each.path).read_bytes()
        assert each.applied(source) != source, each.id
        compile(each.applied(source), each.path, "exec")
