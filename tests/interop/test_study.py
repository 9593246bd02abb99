"""examples/study: its small matrix with real stacks, and its statistics."""

import csv
import gzip
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from examples.study.summary import STACKS as NAMES
from examples.study.summary import coverage, interval, told
from pqsec_pki.trial import STACKS, MissingStackError, SegmentError, find, refuse_without_hosts

STUDY = Path(__file__).parents[2] / "examples/study/study.py"
MISSING = float("inf")


@pytest.mark.slow
@pytest.mark.interop
@pytest.mark.parametrize("stack", STACKS)
def test_the_small_matrix_ends_with_tables_and_plots(stack, requires, tmp_path):
    found = None
    with suppress(MissingStackError, SegmentError):
        found = find(stack)
        refuse_without_hosts()
    requires(found, f"{stack} to compile against, and root", "see `pqsec bench --help`")
    words = [sys.executable, STUDY, tmp_path, "--small", "--stack", stack, "--rounds", "1"]
    for part, rounds in (("pairs", 1), ("pairs", 2), ("versions", 1)):  # a second time adds a round
        done = subprocess.run([*words, "--part", part], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        with gzip.open(tmp_path / f"{part}-{stack}.csv.gz", "rt") as file:
            rows = list(csv.DictReader(file))
        assert len([row for row in rows if row["measure"] == "full_s"]) == 4 * rounds
        assert len([row for row in rows if row["measure"] == "environment.cores"]) == 1
    text = (tmp_path / "tables.md").read_text()
    assert f"## Two hosts, {NAMES[stack]}, MTU 1500" in text
    assert f"## Both versions of the messages, {NAMES[stack]}, MTU 1500" in text
    assert "| pq, version 2 |" in text
    assert (tmp_path / "pairs-meetings.svg").exists()


def test_results_with_other_columns_are_refused(tmp_path):
    """Rows of another version of pqsec would stand below wrong names."""
    with gzip.open(tmp_path / "pairs-cyclonedds.csv.gz", "wt") as file:
        file.write("stack,version,run,measure,value\n")
    words = [sys.executable, STUDY, tmp_path, "--stack", "cyclonedds", "--part", "pairs"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, "was made by another version" in done.stderr) == (1, True), done


def test_the_interval_of_a_median_has_its_coverage():
    """By the binomial distribution; n = 6 and 8 are in every table of the sign test."""
    assert coverage(6, 1) == pytest.approx(0.96875)
    assert coverage(8, 1) == pytest.approx(0.9921875)
    assert coverage(8, 2) == pytest.approx(0.9296875)
    assert interval([3, 1, 2, 6, 5, 4]) == (1, 6, pytest.approx(0.96875))
    assert interval(range(20))[:2] == (5, 14)


def test_too_few_runs_are_told_with_their_own_coverage():
    assert told([0.5, 0.7, 0.6]) == "0.6 [0.5, 0.7] (75%)"


def test_one_or_two_runs_have_no_interval():
    assert told([0.5]) == "0.5"
    assert told([0.7], 1) == "0.7, -"


def test_runs_that_did_not_end_are_later_than_all_others():
    assert told([1.0] * 7 + [2.0] * 2, 1) == "1 [1, 2]"
    assert told([1.0], 7) == "- [1, -]"
    assert told([], 3) == "none"
    assert told([]) == ""
