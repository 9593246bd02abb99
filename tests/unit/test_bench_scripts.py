"""Scripts of bench/ start, and what they compare handshakes with runs: nothing else runs it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[2] / "bench"
ONE_ROUND = """
from pqsec_pki.algorithms import KEY_AGREEMENTS, profile_named
from pqsec_pki.benchmark import suites_of
from suites import floor, handshake, participants, wire
for name in ("classical", "transition", "hybrid", "pq"):
    [suite] = suites_of([profile_named(name)])
    both = participants(suite)
    for run in (handshake(both.initiator, both.responder, suite.agreement), floor(suite)):
        spent = run()
        print(suite.profile, spent.tries > 0, spent.rest > 0)
    assert 0 < wire(suite)().rest
"""


@pytest.mark.timeout(120)
def test_handshakes_and_their_floors_run_for_keys_of_each_kind():
    done = subprocess.run(
        [sys.executable, "-c", ONE_ROUND], cwd=BENCH, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = [line.split() for line in done.stdout.splitlines()]
    assert found == [
        [name, str(name != "classical"), "True"]
        for name in ("classical", "transition", "hybrid", "pq")
        for _ in range(2)
    ]


@pytest.mark.parametrize("name", ["ledger", "plugin", "serve"])
def test_a_script_finds_what_it_runs_against_from_any_folder(name, tmp_path):
    done = subprocess.run(
        [sys.executable, BENCH / f"{name}.py", "--help"],
        cwd=tmp_path,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("usage: ")
