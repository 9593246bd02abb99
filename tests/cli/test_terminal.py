"""What a terminal gets and a pipe does not: colour and width. Errors as JSON, for programs."""

import fcntl
import json
import os
import pty
import re
import shlex
import struct
import subprocess
import sys
import termios
from datetime import datetime, timedelta

import pytest

from pqsec_pki.cli._colour import painted
from tests.cli.conftest import AT_ONCE, ERASE, clean_environment, visible

ESCAPE = "\x1b["
CONTROL = re.compile(r"\x1b\[[0-9;]*m")


@pytest.fixture
def terminal(tmp_path):
    """terminal("check k", columns=60) is what a terminal of that width shows."""

    def run(line, columns=80, program=("-m", "pqsec_pki"), **environment):
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        variables = {"TERM": "xterm", **environment}
        inherited = clean_environment(**variables)
        for name in {"NO_COLOR", "COLUMNS", "PAGER", "NO_PAGER", "LESS"} - set(variables):
            inherited.pop(name, None)
        program = subprocess.Popen(
            [sys.executable, *program, *shlex.split(line)],
            cwd=tmp_path, env=inherited, stdin=theirs, stdout=theirs, stderr=theirs,
        )  # fmt: skip
        os.close(theirs)
        shown = b""
        while piece := _read(ours):
            shown += piece
        os.close(ours)
        run.code = program.wait()
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
        assert CONTROL.sub("", visible(shown)) == piped.out + piped.err


@pytest.mark.parametrize("variable", [{"NO_COLOR": "1"}, {"TERM": "dumb"}], ids=str)
def test_colour_can_be_turned_off(terminal, variable):
    said = terminal("-k nowhere status", **variable)
    assert "error" in said
    assert ESCAPE not in visible(said)


def test_what_comes_from_outside_commands_no_terminal(terminal):
    said = terminal("check \x1b[31mred")
    assert "\\u001b[31mred" in said
    assert "\x1b[31mred" not in said


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_a_table_is_wrapped_to_the_terminal_and_names_stay_whole(terminal, process, columns):
    piped = process("algorithms").done().out
    shown = visible(terminal("algorithms", columns=columns))
    assert set(piped.split()) == set(shown.split())
    if columns == 200:
        assert shown == piped
    else:  # its longest words together are wider
        assert len(shown.splitlines()) > len(piped.splitlines())
        assert max(map(len, shown.splitlines())) < max(map(len, piped.splitlines()))


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


# A pager

EACH = {"PAGER": "sed s/^/paged:/"}
LIST = "explain-error --list"


def test_a_long_result_goes_through_the_pager_with_the_options_of_git(terminal):
    lines = visible(terminal(LIST, **EACH)).splitlines()
    assert len(lines) > 24
    assert all(line.startswith("paged:") for line in lines)
    assert "LESS=FRX" in terminal(LIST, PAGER="sh -c 'echo LESS=$LESS; cat'")
    assert "LESS=S" in terminal(LIST, PAGER="sh -c 'echo LESS=$LESS; cat'", LESS="S")


@pytest.mark.parametrize(
    ("line", "variables"),
    [
        (f"{LIST} --no-pager", {}),
        (LIST, {"NO_PAGER": "1"}),
        (LIST, {"PAGER": "cat"}),
        (LIST, {"PAGER": ""}),
        (LIST, {"TERM": "dumb"}),
        ("explain-error 146", {}),  # short
        ("algorithms", {}),
    ],
)
def test_other_results_are_printed(terminal, line, variables):
    said = visible(terminal(line, **{**EACH, **variables}))
    assert said
    assert "paged:" not in said
    assert terminal.code == 0


def test_a_pipe_is_not_paged(process):
    assert "paged:" not in process(LIST, **EACH).done().out


def test_who_leaves_the_pager_early_changes_no_exit_code(terminal):
    assert terminal(LIST, PAGER="true") == ""
    assert terminal.code == 0


# Times


def test_times_are_in_the_zone_of_the_reader_and_in_utc_for_programs(terminal, process, keystore):
    keystore()
    here = {"TZ": "IST-5:30"}
    piped = process("-k k log", **here).done().out
    assert visible(terminal("-k k log", columns=500, **here)) == piped
    lines = process("-k k log --json").done().json["lines"]
    assert process("-k k log --json", **here).done().json["lines"] == lines
    assert all(each["at"].endswith("Z") for each in lines)
    made = [datetime.fromisoformat(each["at"]) for each in lines]
    in_india = [f"{at + timedelta(hours=5, minutes=30):%Y-%m-%d %H:%M} IST" for at in made]
    assert re.findall(r"[0-9-]{10} [0-9:]{5} [A-Z]+", piped) == in_india


def test_what_ends_soon_is_told_with_the_minute(pqsec, process, keystore):
    """For a certificate of hours, a date says nothing."""
    keystore()
    pqsec("-k k issue /brief --publish x --validity 1h").done()
    pqsec("-k k bundle /brief --plain-key -o b").done()
    place = {"TZ": "IST-5:30"}
    minute = r"20[0-9-]{8} [0-9:]{5} IST"
    assert re.search(rf"until {minute} ", process("install b --dir r --trust-first", **place).out)
    shown = process("-k k status", **place).done().out
    assert re.search(rf"/brief .*{minute}", shown)
    assert len(re.findall(minute, shown)) == 1


# Progress

NAMES = " ".join(f"/n{number}" for number in range(60))
LONG = {
    "ca init": "-k new ca init --no-passphrase",
    "ca rotate": "-k k ca rotate --no-passphrase",
    "demo": "demo new",
    "plan": "-k k plan domain.yaml",
    "apply": "-k k apply domain.yaml --yes",
    "issue": f"-k k issue {NAMES} --publish x",
    "permit": "-k k permit /talker --publish x --yes",
    "renew": "-k k renew /talker /listener",
    "revoke": "-k k revoke /talker --yes",
    "status": "-k k status",
    "log": "-k k log --verify",
    "bundle": "-k k bundle /talker --plain-key -o new.bundle",
    "check": "check k",
    "report": "-k k report -o new.html",
    "who-may": "who-may k",
    "cbom": "cbom k",
    "verify-handshake": "-k k verify-handshake --all",
    "bench": "bench --profile classical --rounds 3",
    "estimate": "estimate --participants 20",
    "migrate plan": "-k k migrate plan --to pq --rehearse",
}
"""Command -> a command line of it that takes over a second for some keystore, log or fleet."""


@pytest.mark.slow(but=8)
@pytest.mark.parametrize("command", LONG)
def test_a_terminal_shows_that_a_command_works_and_how_long(terminal, pqsec, keystore, command):
    keystore("classical")
    pqsec("domain import k -o domain.yaml").done()
    shown = terminal(LONG[command], program=AT_ONCE)
    assert f"{ERASE}pqsec {command}: " in shown
    assert "pqsec: error" not in shown, shown
    assert f"pqsec {command}: " not in visible(shown)


def test_it_counts_where_a_command_counts(terminal, keystore):
    keystore("classical")
    assert re.search(
        r"pqsec issue: [0-9]+ of 60, [0-9] s", terminal(LONG["issue"], program=AT_ONCE)
    )


@pytest.mark.parametrize("variable", [{"TERM": "dumb"}, {"TERM": ""}], ids=str)
def test_a_terminal_that_cannot_erase_shows_none(terminal, keystore, variable):
    keystore("classical")
    assert "pqsec check: " not in terminal("check k", program=AT_ONCE, **variable)


def test_a_pipe_gets_no_progress(keystore, tmp_path):
    keystore("classical")
    command = [sys.executable, *AT_ONCE, "check", "k"]
    piped = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "\r" not in piped.stdout + piped.stderr
    assert "pqsec check: " not in piped.stderr
