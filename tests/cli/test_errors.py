"""What a user does wrong: an exit code, one line that says what, one that says what to do.

Each of these runs in a process of its own, as from a shell.
"""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import threading
import time
from contextlib import suppress
from pathlib import Path

import click
import pytest

from pqsec_pki.cli import COMMANDS, GROUPS
from tests.cli.conftest import PARTICIPANTS, Result, clean_environment, command_of

USAGE = [
    "foo",
    "--foo ca show",
    "ca foo",
    "ca show extra",
    "-k",
    "-k k ca init --profile",
    "-k k ca init --profile no --no-passphrase",
    "-k k issue",
    "-k k issue /a --domain",
    "-k k issue /a --validity soon",
    "-k k issue '' --publish x",
    "-k k/pqsec.json ca show",
    "-k k sign-governance",
    "-k k sign-permissions k",
    "-k k verify-handshake /talker",
    "-k k verify-handshake /talker /listener /third",
    "-k k verify-handshake /talker /listener --kem no",
    "-k k verify-handshake /talker /listener --domain 999",
    "validate",
    "verify",
    "verify k/enclaves/governance.p7s",
    "demo a b",
    "demo --profile no",
    "demo k/pqsec.json",
    "issue /a",
    # what a shell makes of "$VARIABLE" when it is not set
    "-k '' ca init --no-passphrase",
    "-k new ca init --passphrase-file ''",
    "-k k issue /a --domain ''",
    "-k k sign-governance k/enclaves/governance.xml -o '' --force",
    "-k k verify-handshake /talker /listener --kem ''",
    "-k k verify-handshake /talker ''",
    "verify k/enclaves/governance.p7s --ca ''",
    "verify k/enclaves/governance.p7s --require quantum",
    "-k k ca init --no-passphrase --kem ''",
    "inspect",
    "inspect ''",
    "inspect k",
    "validate ''",
    "demo ''",
]
NOT_DONE = [
    "-k no ca show",
    "-k no issue /a",
    "-k k ca init --no-passphrase",
    "-k k issue /talker",
    "-k k verify-handshake /talker /no",
    "-k k verify no",
    "-k k verify k/enclaves/governance.p7s --ca no",
    f"-k k verify k/enclaves/governance.p7s --ca {'x' * 300}.cert.pem",
    "-k k sign-governance no",
    "-k k sign-governance k/enclaves/governance.xml",
    "-k k sign-governance k/enclaves/governance.xml -o no/no",
    "-k new ca init --passphrase-file no",
    "validate no",
    "demo k",
    "-k k demo",
    "inspect no",
    "inspect k/pqsec.json",
    f"inspect {'x' * 300}",
    f"-k {'x' * 300} ca show",
    f"-k new ca init --passphrase-file {'x' * 300}",
    f"-k {'x' * 300} ca init --no-passphrase",
    f"demo {'x' * 300}",
    f"validate {'x' * 5000}",
]
NO = [
    "-k k sign-permissions k/enclaves/governance.xml",
    "-k k verify k/enclaves/governance.xml",
    "-k k verify k/enclaves/governance.p7s --require pq",
]


@pytest.mark.parametrize("line", USAGE)
def test_what_makes_no_sense_ends_with_2(pqsec, keystore, line):
    keystore()
    said = pqsec(line).refused(2)
    assert len(said.err.splitlines()) <= 2


@pytest.mark.parametrize("line", NOT_DONE)
def test_what_cannot_be_done_ends_with_3(pqsec, keystore, line):
    keystore()
    pqsec(line).refused(3)


@pytest.mark.parametrize("line", NO)
def test_what_is_checked_and_refused_ends_with_1(pqsec, keystore, line):
    keystore()
    pqsec(line).refused(1)


@pytest.mark.parametrize("line", [USAGE[0], USAGE[10], NOT_DONE[0], NOT_DONE[5], NO[0], NO[2]])
def test_a_process_ends_as_main_does(pqsec, process, keystore, line):
    keystore()
    one, other = pqsec(line), process(line)
    assert (one.code, one.out, one.err) == (other.code, other.out, other.err)


def test_json_on_error_leaves_stdout_to_results(pqsec, keystore):
    keystore()
    for line in ("--json foo", "--json issue", "--json -k no ca show", f"--json {NO[0]}"):
        said = pqsec(line)
        assert said.out == ""
        assert json.loads(said.err)["errors"]


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("-k no ca show", "no does not exist"),
        ("-k k verify no", "no: no such file or directory"),
        ("verify --ca no k/enclaves/governance.p7s", "no: no such file or directory"),
        ("-k k verify --alt-ca no k/enclaves/governance.p7s", "no: no such file or directory"),
        ("-k k sign-governance no", "no: no such file or directory"),
        ("-k k sign-permissions no", "no: no such file or directory"),
        ("-k new ca init --passphrase-file no", "no: no such file or directory"),
        ("validate no", "no: no such file or directory"),
        ("inspect no", "no: no such file or directory"),
    ],
)
def test_a_missing_file_is_named_once(pqsec, keystore, line, missing):
    keystore()
    assert pqsec(line).refused(3).errors == [missing]


def test_an_unknown_participant_is_answered_with_one_that_is_spelled_alike(pqsec, keystore):
    keystore()
    for line in (
        "renew /tlaker",
        "needs-renewal /tlaker",
        "revoke /tlaker --yes",
        "bundle /tlaker --plain-key",
        "export fastdds /tlaker",
        "explain --participant /tlaker --join",
        "verify-handshake /tlaker /listener",
        "try cyclonedds /tlaker /listener",
    ):
        pqsec(f"-k k {line}").refused(3, "/tlaker", hint="did you mean '/talker'?")


def test_the_name_of_a_robot_alone_is_answered_with_the_pattern_of_its_nodes(pqsec):
    named = ("/r1/a", "/r1/b", "/r2/a", "/r2/x/b", "/r3/a/b")
    pqsec("-k k ca init --profile classical --no-passphrase").done()
    pqsec(f"-k k issue {' '.join(named)} --publish rt/a").done()
    for line in (
        "status /r1",
        "renew /r1",
        "needs-renewal /r1",
        "revoke /r1 --yes",
        "log /r1",
        "bundle /r1 --plain-key",
        "export fastdds /r1",
        "permit /r1 --publish rt/b --yes",
        "explain /r1 --join",
        "who-may --participant /r1",
        "verify-handshake /r1 /r2/a",
    ):
        code = 2 if line.startswith("who-may") else 3
        pqsec(f"-k k {line}").refused(code, "/r1", hint="did you mean '/r1/*' (/r1/a, /r1/b)?")
    pqsec("-k k status /r2").refused(3, hint="did you mean '/r2/**' (/r2/a, /r2/x/b)?")
    pqsec("-k k status /r3").refused(3, hint="did you mean '/r3/a/b'?")


def test_a_wrong_passphrase_names_the_file_of_the_key(pqsec, locked):
    for line in ("issue /a --publish x", "ca crl", "ca passphrase --new-passphrase-file right"):
        said = pqsec(f"-k k {line} --passphrase-file wrong")
        assert "k/private/identity_ca.key.pem: wrong passphrase" in said.err, said


def test_a_document_that_is_not_xml_is_a_no_to_every_command(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "broken.xml").write_text("<policy><enclaves>")
    for line in (
        "validate broken.xml",
        "sign-permissions broken.xml",
        "permissions import broken.xml",
        "permissions read broken.xml",
        "who-may broken.xml",
        "diff broken.xml broken.xml",
        "explain --governance broken.xml --permissions broken.xml --join",
        "inspect broken.xml",
    ):
        said = pqsec(f"-k k {line}")
        assert said.code == 1, said
        assert "broken.xml: line 1: not well-formed XML" in said.out + said.err


@pytest.mark.parametrize("line", ["", "ca"])
def test_a_group_alone_shows_its_help_on_stderr(process, line):
    said = process(line)
    assert said.code == 2
    assert said.out == ""
    assert said.err.startswith("Usage: pqsec")
    assert " COMMAND [ARGS]..." in said.err


# Every command answers


def test_help_lists_the_commands_with_the_help_each_gives(process):
    said = process("--help")
    assert said.code == 0
    assert said.err == ""
    assert [name for name in COMMANDS if f"\n  {name} " not in said.out] == []
    assert [heading for heading in GROUPS if f"\n{heading}:\n" not in said.out] == []
    assert sorted(" ".join(GROUPS.values()).split()) == sorted(COMMANDS)


@pytest.mark.parametrize("option", ["-h", "--help"])
@pytest.mark.parametrize("line", ["ca", "ca init", "issue", "verify", "demo", "inspect"])
def test_help_needs_neither_arguments_nor_keystore(pqsec, line, option):
    assert pqsec(f"{line} {option}").done().out.startswith(f"Usage: pqsec {line} [OPTIONS]")


def test_both_help_options_stay_when_a_command_was_looked_at_alone(pqsec):
    """Click keeps the option that is asked for first."""
    command = command_of(["verify"])
    command.get_help_option(click.Context(command))
    assert pqsec("verify -h").done()


# What help costs

HEAVY = ("cryptography", "jinja2", "lxml", "sqlite3", "yaml")
ROOMS = ("access", "domain", "handshake", "lint", "plugin", "selfcheck")
HEAVY += tuple(f"pqsec_pki.{room}" for room in ROOMS)
LIST_LOADED = """\
import sys
import textwrap
import threading
from pqsec_pki.cli import main
try:
    main()
finally:
    print([name for name in {} if name in sys.modules], file=sys.stderr)
"""


def loaded_by(folder: Path, *arguments: str, names: tuple[str, ...] = HEAVY) -> list[str]:
    """Which of `names` the command loads."""
    done = subprocess.run(
        [sys.executable, "-c", LIST_LOADED.format(names), *arguments],
        cwd=folder,
        env=clean_environment(PYTHONPATH=os.pathsep.join(sys.path)),
        capture_output=True,
        text=True,
        check=False,
    )
    found: list[str] = json.loads(done.stderr.splitlines()[-1].replace("'", '"'))
    return found


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["foo"], []])
def test_help_and_version_load_no_heavy_module(tmp_path, arguments):
    assert loaded_by(tmp_path, *arguments) == []


UNUSED = ("asyncio", "concurrent", "http", "importlib.metadata", "jinja2", "logging", "markupsafe")
UNUSED += ("multiprocessing", "ssl", "subprocess", "zipfile")


@pytest.mark.parametrize(
    "arguments",
    [
        "issue /more --publish chatter",
        "status",
        f"explain --participant {PARTICIPANTS[0]} --publish rt/chatter",
        "verify k/enclaves/governance.p7s",
    ],
)
def test_common_commands_load_no_module_that_they_do_not_use(tmp_path, keystore, arguments):
    keystore()
    assert loaded_by(tmp_path, "-k", "k", *arguments.split(), names=(*UNUSED, "hashlib")) == [
        "hashlib"
    ]


def test_the_list_of_what_was_loaded_is_true(tmp_path):
    assert "cryptography" in loaded_by(tmp_path, "profiles")


def test_profiles_and_algorithms_load_no_more_than_cryptography(tmp_path):
    for command in ("profiles", "algorithms"):
        assert loaded_by(tmp_path, command) == ["cryptography"]


def test_issue_loads_no_room_that_it_does_not_use(tmp_path):
    loaded_by(tmp_path, "-k", "k", "ca", "init", "--no-passphrase")
    assert [each for each in loaded_by(tmp_path, "-k", "k", "issue", "/a") if "." in each] == []


# Streams and signals


def start(folder, line, **streams):
    command = [sys.executable, "-m", "pqsec_pki", *line.split()]
    settings = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, cwd=folder, env=clean_environment(), **settings | streams)


def test_a_reader_that_left_ends_it_quietly(tmp_path):
    reading, writing = os.pipe()
    with start(tmp_path, "algorithms", stdout=writing) as process:
        os.close(writing)
        os.close(reading)
        assert process.stderr.read() == b""
    assert process.returncode == -signal.SIGPIPE  # a shell calls it 141


def test_a_reader_of_errors_that_left_ends_it_quietly(tmp_path):
    reading, writing = os.pipe()
    with start(tmp_path, "nonsense", stdout=writing, stderr=writing) as process:
        os.close(writing)
        os.close(reading)
    assert process.returncode == -signal.SIGPIPE


def test_what_was_open_is_closed_when_a_reader_has_left(tmp_path):
    """The folder that a command made for its work, for example."""
    script = """
        import sys, click, pathlib
        from contextlib import contextmanager
        from pqsec_pki.cli import algorithms, main
        @contextmanager
        def work():
            try:
                yield
            finally:
                pathlib.Path("closed").touch()
        @click.command
        def profiles():
            with work():
                click.echo("result")
        algorithms.profiles = profiles
        sys.argv = ["pqsec", "profiles"]
        main()
    """
    reading, writing = os.pipe()
    command = [sys.executable, "-c", textwrap.dedent(script)]
    with subprocess.Popen(command, cwd=tmp_path, stdout=writing, stderr=subprocess.PIPE) as process:
        os.close(writing)
        os.close(reading)
        assert process.stderr.read() == b""
    assert (process.returncode, (tmp_path / "closed").exists()) == (-signal.SIGPIPE, True)


def test_a_peer_that_closes_a_connection_is_an_error_and_ends_nothing_quietly(tmp_path):
    """Of a signer in a token, for example, whose library says no more than the system did."""
    script = """
        import sys, click, socket
        from pqsec_pki.cli import algorithms, main
        @click.command
        def profiles():
            ours, theirs = socket.socketpair()
            theirs.close()
            ours.sendall(b"question")
        algorithms.profiles = profiles
        sys.argv = ["pqsec", "profiles"]
        main()
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    Result(done.returncode, done.stdout, done.stderr).refused(
        3, "the other side of a connection closed it", hint="run the command again"
    )


@pytest.mark.parametrize("linger", [b"", struct.pack("ii", 1, 0)], ids=["closed", "reset"])
@pytest.mark.parametrize("octets", [0, 1, 600])
def test_enrol_at_a_server_that_closes_is_an_error(tmp_path, linger, octets):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=close_each, args=(listener, linger, octets), daemon=True).start()
        url = f"https://127.0.0.1:{listener.getsockname()[1]}"
        options = f"--name /r --dir robot --server-pin {'0' * 64} --trust-first --profile pq"
        process = start(tmp_path, f"enrol {url} {options}")
        out, err = process.communicate(timeout=300)
    assert process.returncode == 3, err
    assert "run the command again" in err.decode()
    assert out == b""


def close_each(listener, linger, octets):
    """Close each connection after that many octets: in order, or with a reset."""
    with suppress(OSError):
        while True:
            link, _ = listener.accept()
            if linger:
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            if octets:
                link.recv(octets)
            link.close()


@pytest.mark.parametrize("option", ["", "--json"])
def test_a_full_disk_below_the_result_is_an_error(tmp_path, option):
    with (
        Path("/dev/full").open("wb") as full,
        start(tmp_path, f"profiles {option}", stdout=full) as process,
    ):
        code, err = process.wait(), process.stderr.read().decode()
    Result(code, "", err).refused(
        3, "the result cannot be printed: no space left on device", hint="command itself succeeded"
    )


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("-k k verify-handshake --all --json", 0),
        ("-k new ca init", 2),
        ("-k k issue /new --publish x --json", 0),
        ("-k k verify no", 3),
    ],
)
def test_a_stream_that_is_closed_changes_nothing_else(tmp_path, keystore, line, code, closed):
    """Whatever is opened next must not get the number of that stream, and be written to."""
    keystore()
    done = subprocess.run(
        ["sh", "-c", f"exec {sys.executable} -m pqsec_pki {line} {closed}"],
        cwd=tmp_path,
        env=clean_environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )
    assert done.returncode == code
    assert b"Traceback" not in done.stderr
    assert bool(done.stdout) == (code == 0 and ">&-" not in closed.split())
    assert bool(done.stderr) == (code != 0 and "2>&-" not in closed)


def test_a_folder_that_is_gone_is_told(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    line = f"rmdir {gone}; exec {sys.executable} -m pqsec_pki profiles"
    done = subprocess.run(
        ["sh", "-c", line],
        cwd=gone,
        env=clean_environment(PYTHONPATH=os.pathsep.join(filter(None, sys.path))),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 3
    assert done.stdout == ""
    assert done.stderr.startswith("pqsec: error: the current folder")


def test_what_is_made_can_be_read_whatever_the_umask(pqsec, tmp_path):
    """Of the umask only the others' part counts; 0o777 would let nobody finish."""
    before = os.umask(0o777)
    try:
        pqsec("demo made").done()
    finally:
        os.umask(before)
    modes = {path.stat().st_mode & 0o700 for path in (tmp_path / "made").rglob("*")}
    assert modes == {0o600, 0o700}


def test_what_a_terminal_would_obey_is_not_printed(pqsec, tmp_path):
    name = "k\x1b[2J\u202e\n/talker  until 2099-01-01"
    said = pqsec("ca init --no-passphrase --profile classical -k", name).done()
    assert said.out.startswith("keystore       k\\u001b[2J\\u202e\\u000a/talker  until")
    assert pqsec("ca show --json -k", name).done().json["keystore"] == name


def test_a_copy_that_cannot_be_written_hides_no_work(pqsec, keystore, tmp_path):
    keystore()
    pqsec("-k k ca crl -o no/copy").refused(3, "no/copy", hint="`pqsec ca crl --show -o FILE`")
    pqsec("-k k ca crl --show -o copy").done()
    assert (tmp_path / "copy").read_bytes() == (
        tmp_path / "k/public/identity_ca.crl.pem"
    ).read_bytes()


@pytest.mark.parametrize(("kind", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_polite_kill_ends_it_with_nothing_half_made(tmp_path, keystore, kind, code):
    """1000 participants take seconds; the interrupt comes while they are drafted."""
    k = keystore("pq")
    names = " ".join(f"/n{number}" for number in range(1000))
    with start(tmp_path, f"-k k issue --publish x {names}") as process:
        give_up = time.monotonic() + 300
        while not list(k.glob(".draft-*")) and time.monotonic() < give_up:
            time.sleep(0.005)
        process.send_signal(kind)
        out, err = process.communicate()
    assert process.returncode == code
    assert out == b""
    last = "pqsec: error: interrupted\n" if kind == signal.SIGINT else ""
    assert err.decode().endswith(last)
    assert b"Traceback" not in err
    assert {path.name for path in (k / "enclaves").iterdir() if path.is_dir()} == {
        "talker",
        "listener",
    }
    assert not list(k.glob(".draft-*"))


def test_a_path_that_is_no_text_is_shown_all_the_same(process, tmp_path):
    name = os.fsdecode(b"k\xff")
    said = process("-k", name, "ca", "init", "--no-passphrase", PYTHONIOENCODING="utf-8:strict")
    assert said.code == 0
    assert said.out.startswith("keystore       k\\udcff (profile transition")
    assert (tmp_path / name / "pqsec.json").is_file()


def test_a_full_disk_keeps_no_half_made_keys(tmp_path):
    """Files of more than 2 KB fail: the key fits, the request does not."""
    line = f"ulimit -f 4; exec {sys.executable} -m pqsec_pki request /new --dir r"
    done = subprocess.run(
        ["sh", "-c", line],
        cwd=tmp_path,
        env=clean_environment(PYTHONDONTWRITEBYTECODE="1"),
        capture_output=True,
        check=False,
    )
    assert done.returncode == 3
    assert done.stderr == b"pqsec: error: r: file too large\n"
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_name_in_a_file_is_told_with_the_file_and_in_short(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "robot").write_text("/talker\n" + "?" * 100_000)
    said = pqsec("-k k bundle --robot robot --plain-key -o out").refused(2, "robot: '???")
    assert len(said.err) < 500


# what a wrong command line is told


def test_choices_are_listed_on_one_line(pqsec):
    said = pqsec("export").refused(2, "Choose from: cyclonedds, fastdds, opendds, connext, ros2")
    assert "\\u000a" not in said.err


def test_an_option_without_its_value_names_the_help_of_its_command(pqsec):
    pqsec("check --explain").refused(2, "requires an argument", hint="`pqsec check --help` shows")


def test_an_unknown_command_is_told_where_the_commands_are(pqsec):
    pqsec("statsu").refused(2, "Did you mean 'status'", hint="`pqsec --help` lists its commands")
    pqsec("ca shwo").refused(2, "No such command", hint="`pqsec ca --help` lists its commands")


def test_inside_a_keystore_its_own_folder_is_suggested(pqsec, run_in, keystore, tmp_path):
    keystore("classical")
    run_in(tmp_path / "k", "status").refused(2, "no keystore named", hint="use -k .")


def test_a_head_that_cannot_be_one_is_not_called_a_changed_ledger(pqsec, keystore):
    keystore("classical")
    pqsec("-k k log --head abc").refused(2, "'abc' is not a head", hint="log --verify")


def test_a_path_that_does_not_exist_is_not_called_a_file(pqsec, keystore):
    keystore("classical")
    pqsec("diff k nowhere").refused(3, "nowhere: no such file or directory")


def test_no_passphrase_on_the_command_line_outranks_the_variable(pqsec, tmp_path):
    (tmp_path / "passphrase").write_text("secret\n")
    (tmp_path / "passphrase").chmod(0o600)
    variable = {"PQSEC_PASSPHRASE_FILE": "passphrase"}
    done = pqsec("-k open ca init --profile classical --no-passphrase", **variable).done()
    assert "CA keys        not encrypted" in done.out
    line = "-k other ca init --no-passphrase --passphrase-file passphrase"
    pqsec(line).refused(2, "--passphrase-file and --no-passphrase exclude each other")


def test_a_dds_topic_that_looks_like_a_ros_2_name_is_noted(pqsec, keystore):
    keystore("classical")
    done = pqsec("-k k issue /camera --publish /image --subscribe rt/go").done()
    assert done.err == (
        "pqsec: note: /image is a DDS topic here, and ROS 2 nodes use rt/image: for that, use"
        " --ros-publish /image\n"
    )
