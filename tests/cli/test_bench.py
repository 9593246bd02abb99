"""pqsec bench: its table, its JSON and CSV, and what Ctrl-C leaves."""

import csv
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest

from pqsec_pki.benchmark import measuring

PQ = "bench --profile pq --rounds 2 --warm-up 0"


def test_the_table_has_a_row_for_each_suite(pqsec):
    done = pqsec("bench --rounds 1 --warm-up 0 --kem mlkem768 --profile pq --profile hybrid").done()
    head, pq, hybrid, empty, *_ = done.out.splitlines()
    assert (head.split()[:2], empty) == (["profile", "signature"], "")
    assert pq.split()[:3] == ["pq", "ml-dsa-65", "mlkem768"]
    assert hybrid.split()[:2] == ["mldsa65-ecdsa-p256-sha512", "mlkem768"]  # not the profile's own
    assert "cryptography " in done.out


def test_json_has_samples_and_the_environment(pqsec):
    value = pqsec(f"{PQ} --json").done().json
    assert value["complete"]
    assert {"pqsec", "python", "openssl", "cores", "governor"} <= set(value["environment"])
    [suite] = value["suites"]
    assert (suite["profile"], suite["rounds"], len(suite["samples"])) == ("pq", 2, 8)
    assert len(suite["fragments"]) == 3


def test_csv_has_a_line_for_each_operation(pqsec):
    rows = list(csv.DictReader(StringIO(pqsec(f"{PQ} --format csv").done().out)))
    assert len(rows) == 8
    assert {row["operation"] for row in rows} == {
        *("begin_handshake_request", "begin_handshake_reply"),
        *("process_handshake (reply)", "process_handshake (final)"),
    }
    assert all(float(row["wall_us"]) > 0 for row in rows)


def test_the_second_version_is_measured_where_there_is_one(pqsec):
    line = "bench --rounds 1 --warm-up 0 --profile pq --profile classical --json"
    first, second = (pqsec(f"{line} {more}").done().json for more in ("", "--wire-version 2"))
    assert [each["wire_version"] for each in first["suites"]] == [1, 1]
    assert [each["wire_version"] for each in second["suites"]] == [2, 1]
    one, other = (sum(each["suites"][0]["token_bytes"]) for each in (first, second))
    assert other < 0.72 * one


def test_both_versions_are_measured_together(pqsec):
    line = "bench --rounds 1 --warm-up 0 --profile pq --profile classical"
    _, *rows = pqsec(f"{line} --wire-version 1 --wire-version 2").done().out.splitlines()
    versions = [(words[0], words[3]) for words in map(str.split, rows[:3])]
    assert versions == [("pq", "1"), ("pq", "2"), ("classical", "1")]


@pytest.fixture
def interrupted(monkeypatch):
    """interrupted(n): Ctrl-C comes in the n-th round."""

    def after(count):
        rounds, undisturbed = [], measuring._undisturbed

        def run(*arguments):
            rounds.append(1)
            if len(rounds) == count:
                raise KeyboardInterrupt
            return undisturbed(*arguments)

        monkeypatch.setattr(measuring, "_undisturbed", run)

    return after


def test_an_interruption_prints_what_was_measured(pqsec, interrupted):
    interrupted(4)
    done = pqsec("bench --json --rounds 2 --warm-up 0")
    assert done.code == 130
    assert not done.json["complete"]
    assert [suite["rounds"] for suite in done.json["suites"]] == [2, 1]
    assert "interrupted" in done.err


def test_an_interruption_before_the_first_round_prints_none(pqsec, interrupted):
    interrupted(1)
    done = pqsec("bench --json --rounds 2 --warm-up 0")
    assert (done.code, done.json["suites"]) == (130, [])


def test_a_full_disk_is_told():
    command = [sys.executable, "-m", "pqsec_pki", *PQ.split()]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False)
    assert (done.returncode, b"the command itself succeeded" in done.stderr) == (3, True)


def test_what_cannot_be_measured_is_refused(pqsec):
    for line, words in (
        ("bench --signature rsa", "no signature algorithm named 'rsa'"),
        ("bench --kem ml-kem", "no key agreement named 'ml-kem'"),
        ("bench --all --kem mlkem768", "--all measures everything"),
        ("bench --rounds 0", "--rounds"),
        ("bench --hosts 3", "--hosts is for hosts of a stack"),
        ("bench --loss 0", "--loss is for hosts of a stack"),
        ("bench --samples 0", "--samples is for hosts of a stack"),
        ("bench --plugins stock", "--plugins is for hosts of a stack"),
        ("bench --stack ros2", "--stack"),
        ("bench --stack cyclonedds --kem mlkem768", "--kem is for handshakes in memory"),
        ("bench --stack cyclonedds --all", "--all is for handshakes in memory"),
        ("bench --stack cyclonedds --warm-up 0", "--warm-up is for handshakes in memory"),
        ("bench --stack cyclonedds --wire-version 3", "--wire-version"),
        ("bench --stack cyclonedds --plugins stock --wire-version 2", "know version 1 only"),
        ("bench --stack cyclonedds --plugins none --wire-version 2", "know version 1 only"),
        (
            "bench --stack cyclonedds --profile classical --wire-version 2",
            "messages of profile classical have only version 1",
        ),
        ("bench --stack cyclonedds --hosts 1", "--hosts"),
        ("bench --stack cyclonedds --hosts 201", "--hosts"),
        ("bench --stack cyclonedds --loss 51%", "not a loss from 0% to 50%"),
        ("bench --stack cyclonedds --loss nan", "not a loss from 0% to 50%"),
        ("bench --stack cyclonedds --delay nan", "not a finite number"),
        ("bench --stack cyclonedds --mtu 68", "--mtu"),
        ("bench --stack cyclonedds --timeout 0", "--timeout"),
        ("bench --stack cyclonedds --plugins ours", "--plugins"),
        ("bench --stack cyclonedds --json --format csv", "exclude each other"),
    ):
        pqsec(line).refused(2, words)


def test_a_missing_stack_is_named_with_its_packages(pqsec, tmp_path):
    (tmp_path / "root").mkdir()
    done = pqsec("bench --stack cyclonedds --root root")
    done.refused(3, "is not installed", hint="cyclonedds-dev")


PLOT = f"{PQ} --plot plots"


def test_a_plot_is_drawn_beside_the_table(pqsec, tmp_path):
    assert pqsec(PLOT).done().out.startswith("profile ")
    assert b"<svg" in (tmp_path / "plots/suites.svg").read_bytes()
    pqsec(PLOT).refused(3, "suites.svg exists", hint="--force")
    pqsec(f"{PLOT} --force").done()


def test_without_the_library_nothing_is_measured(pqsec, tmp_path, monkeypatch, interrupted):
    interrupted(1)
    monkeypatch.delitem(sys.modules, "pqsec_pki.benchmark.plots", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    pqsec(PLOT).refused(3, "the library for plots is not installed", hint="pip install 'matplotlib")
    assert not (tmp_path / "plots").exists()
