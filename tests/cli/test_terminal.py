"""What a terminal gets and a pipe does not: colour and width. Errors as JSON, for programs."""

import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from datetime import datetime, timedelta

import pytest

from pqsec_pki.cli._colour import painted
from tests.cli.conftest import clean_environment

ESCAPE = "\x1b["
CONTROL = re.compile(r"\x1b\[[0-9;]*m")


@pytest.fixture
def terminal(tmp_path):
    """terminal("check k", columns=60) is what a terminal of that width shows."""

    def run(line, columns=80, **environment):
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        variables = {"TERM": "xterm", **environment}
        inherited = clean_environment(**variables)
        for name in {"NO_COLOR", "COLUMNS"} - set(variables):
            inherited.pop(name, None)
        program = subprocess.Popen(
            [sys.executable, "-m", "pqsec_pki", *line.split()],
            cwd=tmp_path, env=inherited, stdin=theirs, stdout=theirs, stderr=theirs,
        )  # fmt: skip
        os.close(theirs)
        shown = b""
        while piece := _read(ours):
            shown += piece
        os.close(ours)
        program.wait()
        return shown.decode().replace("\r\n", "\n")

    return run


def _read(handle):
    try:
        return os.read(handle, 1 << 16)
    except OSError:  # the other end is closed
        return b""


def test_a_terminal_gets_colours_and_the_same_words_as_a_pipe(terminal, process, keystore):
    keystore()
    for line in ("-k k status", "check k --strict", "-k nowhere status", "-k k statu"):
        piped = process(line)
        assert ESCAPE not in piped.out + piped.err
        shown = terminal(line, columns=500)
        assert ESCAPE in shown
        assert CONTROL.sub("", shown) == piped.out + piped.err


@pytest.mark.parametrize("variable", [{"NO_COLOR": "1"}, {"TERM": "dumb"}], ids=str)
def test_colour_can_be_turned_off(terminal, variable):
    said = terminal("-k nowhere status", **variable)
    assert "error" in said
    assert ESCAPE not in said


def test_what_comes_from_outside_commands_no_terminal(terminal):
    said = terminal("check \x1b[31mred")
    assert "\\u001b[31mred" in said
    assert "\x1b[31mred" not in said


def test_a_table_is_wrapped_to_the_terminal_and_names_stay_whole(terminal, process):
    narrow, piped = terminal("algorithms", columns=70), process("algorithms").done().out
    assert max(map(len, piped.splitlines())) > 80
    assert len(narrow.splitlines()) > len(piped.splitlines())
    assert set(piped.split()) == set(narrow.split())


@pytest.mark.parametrize(
    ("line", "colour"),
    [
        ("FAIL  documents", 31),
        ("/a      expired  2026-01-02  pq", 31),
        ("/a      due      2026-01-02  pq", 33),
        ("/a      valid    2026-01-02  pq", 32),
        ("k/cert.pem:4: error PQS301 it is", 31),
        ("k/cert.pem: info PQS301 it is", 36),
        ("ok    authenticated", 32),
    ],
)
def test_a_word_with_a_meaning_has_its_colour(line, colour):
    assert f"\x1b[{colour}m" in painted(line)
    assert CONTROL.sub("", painted(line)) == line


@pytest.mark.parametrize("line", ["okay", "/valid/a  x", "robots: error in x", "1 error", ""])
def test_other_words_have_none(line):
    assert painted(line) == line


# Errors as JSON


def errors(said, code):
    assert said.code == code
    assert said.out == ""
    [line] = said.err.splitlines()
    value = json.loads(line)
    assert value.keys() == {"version", "errors", "hint", "exit_code"}
    assert (value["version"], value["exit_code"]) == (1, code)
    return value


@pytest.mark.parametrize("option", ["--json", "--format json"])
def test_an_error_is_json_where_json_is_asked(pqsec, option):
    value = errors(pqsec(f"-k nowhere status {option}"), 3)
    [error] = value["errors"]
    assert "nowhere" in error["message"]
    assert value["hint"]


def test_every_problem_of_a_file_is_an_entry_with_its_line(pqsec, tmp_path):
    (tmp_path / "bad.yaml").write_text("domains: 010\nrtps_protection_kind: no\n")
    value = errors(pqsec("governance render bad.yaml --json"), 1)
    assert [(each["subject"], each["line"]) for each in value["errors"]] == [
        ("bad.yaml", 1),
        ("bad.yaml", 2),
    ]
    assert {each["code"] for each in value["errors"]} == {"other"}


def test_a_code_says_which_error_it_is(pqsec):
    [error] = errors(pqsec("inspect nowhere.pem --json"), 3)["errors"]
    assert error["code"] == "file-missing"


@pytest.mark.parametrize("line", ["statu --json", "status --nosuch --json", "--json -k '' status"])
def test_a_wrong_command_line_is_json_too(pqsec, line):
    value = errors(pqsec(line), 2)
    assert "--help" in value["hint"]


# Times


def test_times_are_in_the_zone_of_the_reader_and_in_utc_for_programs(terminal, process, keystore):
    keystore()
    here = {"TZ": "IST-5:30"}
    piped = process("-k k log", **here).done().out
    assert terminal("-k k log", columns=500, **here) == piped
    lines = process("-k k log --json").done().json["lines"]
    assert process("-k k log --json", **here).done().json["lines"] == lines
    assert all(each["at"].endswith("Z") for each in lines)
    made = [datetime.fromisoformat(each["at"]) for each in lines]
    in_india = [f"{at + timedelta(hours=5, minutes=30):%Y-%m-%d %H:%M} IST" for at in made]
    assert re.findall(r"[0-9-]{10} [0-9:]{5} [A-Z]+", piped) == in_india
