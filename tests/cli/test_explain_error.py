"""pqsec explain-error: what it takes, what it says, how it ends."""

import subprocess
import sys

import pytest

from pqsec_pki.cli._paragraph import WIDTH
from pqsec_pki.cli.explain_error import MAX_LOG, MOST_ALIKE
from tests.cli.conftest import clean_environment

SUBJECT = "Subject name is invalid"


@pytest.mark.parametrize("words", ["146", "'Subject name is invalid(code: 146)'", SUBJECT])
def test_a_message_is_explained(pqsec, words):
    out = pqsec(f"explain-error {words}").done().out
    assert out.startswith(f"Cyclone DDS, code 146: {SUBJECT}\n  cause   No grant")
    assert "\n  remedy  Compare `pqsec inspect cert.pem`" in out


def test_lines_are_short_and_no_command_is_broken(pqsec):
    lines = pqsec("explain-error 125").done().out.splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert not [line for line in lines if line.count("`") % 2]


def test_an_unknown_message_ends_with_1_and_what_is_near(pqsec):
    result = pqsec("explain-error the subject name is wrong")
    assert (result.code, result.err) == (1, "")
    assert result.out.startswith("The text does not contain a known message.\nSimilar messages:\n")
    assert f"  Cyclone DDS, code 146: {SUBJECT}\n" in result.out


def test_an_unknown_message_without_anything_near(pqsec):
    result = pqsec("explain-error zebra")
    assert (result.code, result.out) == (1, "The text does not contain a known message.\n")


def test_another_stack_does_not_say_it(pqsec):
    assert pqsec("explain-error --stack cyclonedds 146").code == 0
    assert pqsec("explain-error --stack fastdds 146").code == 1


def test_json_has_all_of_it(pqsec):
    value = pqsec("--json explain-error", "rt/a denied by default rule(code: 145)").done().json
    (found,) = value["known"]
    assert value["nearest"] == []
    assert found["stacks"] == ["cyclonedds"]
    assert (found["said"], found["values"]) == ("rt/a denied by default rule", {"topic": "rt/a"})
    assert (found["line"], found["times"], found["kind"]) == (1, 1, "cause")
    assert "rt/a" in found["cause"]
    assert "--publish rt/a" in found["remedy"]
    assert found["evidence"].startswith("measured")


def test_json_of_an_unknown_message(pqsec):
    result = pqsec("--json explain-error certificate authentication algorithm")
    assert result.code == 1
    assert result.json["known"] == []
    assert 125 in [each["code"] for each in result.json["nearest"]]


def test_the_list_has_every_message(pqsec):
    heads, *lines = pqsec("explain-error --list").done().out.splitlines()
    assert heads.split() == ["stack", "code", "message"]
    assert [line for line in lines if line.split(maxsplit=2) == ["cyclonedds", "146", SUBJECT]]
    everything = pqsec("--json explain-error --list").done().json["messages"]
    assert sum(len(row["texts"]) or 1 for row in everything) == len(lines)


def test_the_list_of_one_stack_is_a_part_of_it(pqsec):
    everything = pqsec("--json explain-error --list").json["messages"]
    ros2 = pqsec("--json explain-error --list --stack ros2").done().json["messages"]
    assert ros2 == [row for row in everything if "ros2" in row["stacks"]]


def explained(data: bytes) -> subprocess.CompletedProcess[bytes]:
    """What becomes of a log on standard input."""
    return subprocess.run(
        [sys.executable, "-m", "pqsec_pki", "explain-error", "-"],
        input=data,
        env=clean_environment(),
        capture_output=True,
        check=False,
        timeout=300,
    )


def test_a_log_is_read_from_standard_input():
    log = b"all is well\n\xff\xfe\nfailed to create topic [rt/a] for unknown reasons\n" * 2
    done = explained(log)
    assert done.returncode == 0
    assert b"rt/a] for unknown reasons (line 3, 2 times)\n" in done.stdout


def test_a_flood_of_one_message_does_not_drown_the_others():
    flood = [f"rt/t{number} denied by default rule(code: 145)" for number in range(1000)]
    done = explained("\n".join([*flood, "Subject name is invalid"]).encode())
    assert done.stdout.count(b"rt/t") == 2 * 2 * MOST_ALIKE - MOST_ALIKE
    assert b"Cyclone DDS: {topic} denied by default rule: 997 more" in done.stdout
    assert SUBJECT.encode() in done.stdout


def test_a_log_without_a_known_message_ends_with_1():
    assert explained(b"all is well\n").returncode == 1


def test_a_log_that_is_too_long_is_refused():
    done = explained(b"x" * (MAX_LOG + 1))
    assert done.returncode == 3
    assert b"error: standard input has more than 16 MiB\n" in done.stderr
    assert b"hint: " in done.stderr


@pytest.mark.parametrize(
    ("redirection", "code", "words"),
    [("<&-", 2, "no message given"), ("0> /dev/null", 3, "cannot be read: bad file")],
    ids=["closed", "not for reading"],
)
def test_a_standard_input_that_is_none_is_refused(redirection, code, words):
    line = f'exec "$0" -m pqsec_pki explain-error - {redirection}'
    done = subprocess.run(
        ["sh", "-c", line, sys.executable],
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == code
    assert done.stderr.startswith("pqsec: error: ")
    assert words in done.stderr


@pytest.mark.parametrize("line", ["explain-error", "explain-error ''", "explain-error -"])
def test_no_message_is_no_use(pqsec, line):
    pqsec(line).refused(2, "no message given", hint="stdin")


def test_the_list_takes_no_text(pqsec):
    pqsec("explain-error --list 146").refused(2, "--list and TEXT exclude each other")


def test_an_unknown_stack_is_refused(pqsec):
    pqsec("explain-error --stack gurum 146").refused(2, "gurum")
