"""The agent at a socket that systemd listens at, as systemd hands it over; and the units."""

import os
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import time
from configparser import ConfigParser
from contextlib import contextmanager
from pathlib import Path

import pytest

from pqsec_pki.errors import ExistsError, FileError
from pqsec_pki.plugin import AgentFolder, agent_status, control, stop_agent, units_folder
from pqsec_pki.plugin.units import planned_units, write_units

PATIENCE = 120
# What systemd does between fork and exec (sd_listen_fds(3)): the handle, and whose it is.
_HAND_OVER = (
    "import os, sys\n"
    "os.dup2(int(sys.argv[1]), 3) if sys.argv[1] else os.closerange(3, 9)\n"
    "os.environ |= {'LISTEN_PID': str(os.getpid()), 'LISTEN_FDS': sys.argv[2]}\n"
    "os.execv(sys.executable, [sys.executable, '-I', '-m', 'pqsec_pki', 'agent', 'run'])\n"
)


@pytest.fixture
def runtime():
    """A runtime folder of this test's own; a socket's path must be short."""
    folder = Path(tempfile.mkdtemp(prefix="pqsec-"))
    (folder / "pqsec").mkdir(mode=0o700)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def place(runtime):
    return AgentFolder.of({"XDG_RUNTIME_DIR": str(runtime)})


def bound(path, kind=socket.SOCK_STREAM):
    listener = socket.socket(socket.AF_UNIX, kind)
    listener.bind(str(path))
    return listener


@contextmanager
def handed(runtime, handle, count=1):
    """`agent run` with a handle that systemd gave it; with none that is open, if that is ""."""
    process = subprocess.Popen(
        [sys.executable, "-c", _HAND_OVER, str(handle), str(count)],
        env=os.environ | {"XDG_RUNTIME_DIR": str(runtime)},
        pass_fds=[handle] if handle else [],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def answered(place):
    """The status of an agent that is starting, which takes long on a busy machine."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return agent_status(place)
        except FileError:
            if time.monotonic() > end:
                raise


def test_an_agent_that_does_not_answer_is_not_told_as_none(monkeypatch, place):
    """`pqsec agent status` said that none runs, while systemd started it."""
    monkeypatch.setattr(control, "_SECONDS", 0.1)
    with bound(place.socket) as listener:
        listener.listen()
        with pytest.raises(FileError, match="the agent does not answer: timed out"):
            agent_status(place)


def test_who_connects_before_the_agent_runs_is_served_and_the_socket_stays(runtime, place):
    with bound(place.socket) as listener:
        listener.listen()
        with handed(runtime, listener.fileno()) as process:
            assert answered(place).process == process.pid  # which waited in the backlog
            assert stop_agent(place)
            assert process.wait(PATIENCE) == 0
        assert place.socket.exists()  # it is systemd's
        with handed(runtime, listener.fileno()) as process:
            assert answered(place).process == process.pid


@pytest.mark.parametrize(
    ("flaw", "words"),
    [
        ("elsewhere", "the library connects to"),
        ("no listener", "the library connects to"),
        ("another kind", "the library connects to"),
        ("two sockets", "must pass exactly one socket"),
        ("a file", "must pass exactly one socket"),
        ("nothing", "what systemd passed is not a socket: Bad file descriptor"),
        ("a folder for all", "is not a folder of this user's alone"),
    ],
)
def test_another_handle_than_the_librarys_socket_is_refused(runtime, place, flaw, words):
    path = runtime / "other.sock" if flaw == "elsewhere" else place.socket
    kind = socket.SOCK_SEQPACKET if flaw == "another kind" else socket.SOCK_STREAM
    with bound(path, kind) as listener, tempfile.TemporaryFile() as file:
        if flaw != "no listener":
            listener.listen()
        if flaw == "a folder for all":
            place.folder.chmod(0o755)
        handle = "" if flaw == "nothing" else (file if flaw == "a file" else listener).fileno()
        with handed(runtime, handle, 2 if flaw == "two sockets" else 1) as process:
            _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 3
    assert words in said


def test_a_socket_that_is_for_another_process_is_left_alone(runtime, place):
    """LISTEN_PID says for which process; children inherit the variables."""
    environment = {"XDG_RUNTIME_DIR": str(runtime), "LISTEN_PID": "1", "LISTEN_FDS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-I", "-m", "pqsec_pki", "agent", "run"],
        env=os.environ | environment,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert "listening at" in process.stderr.readline()
        assert agent_status(place).process == process.pid
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def written(folder, *, force=False):
    units = planned_units(folder, force=force)
    write_units(units)
    return tuple(units)


def test_the_units_name_this_interpreter_and_the_librarys_socket(tmp_path):
    paths = written(tmp_path / "user")
    assert [stat.S_IMODE(path.stat().st_mode) for path in paths] == [0o644, 0o644]
    units = {}
    for path in paths:
        units[path.suffix] = ConfigParser(interpolation=None)
        units[path.suffix].read(path)
    assert units[".socket"]["Socket"]["ListenStream"] == "%t/pqsec/agent.sock"
    command = units[".service"]["Service"]["ExecStart"]
    assert command == f'"{sys.executable}" -I -m pqsec_pki agent run'


def test_a_path_with_words_of_systemds_own_is_quoted(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", '/a b/50%/"$HOME"\\python')
    _, service = written(tmp_path)
    assert 'ExecStart="/a b/50%%/\\"$$HOME\\"\\\\python" -I' in service.read_text()


def test_units_are_not_overwritten_unless_they_are_the_same_or_that_is_wanted(tmp_path):
    paths = written(tmp_path)
    assert written(tmp_path) == paths
    paths[1].write_text("mine")
    with pytest.raises(ExistsError, match=r"pqsec-agent\.service exists"):
        written(tmp_path)
    assert paths[1].read_text() == "mine"
    written(tmp_path, force=True)
    assert "ExecStart" in paths[1].read_text()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_understands_the_units(runtime, tmp_path):
    done = subprocess.run(
        ["systemd-analyze", "verify", "--user", *written(tmp_path)],
        env=os.environ | {"XDG_RUNTIME_DIR": str(runtime)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_units_are_where_systemd_looks(monkeypatch, tmp_path):
    assert units_folder({"XDG_CONFIG_HOME": str(tmp_path)}) == tmp_path / "systemd/user"
    monkeypatch.setenv("HOME", "/home/robot")
    for environment in ({}, {"XDG_CONFIG_HOME": "here"}):
        assert units_folder(environment) == Path("/home/robot/.config/systemd/user")


def test_who_has_no_home_is_told(monkeypatch):
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 3_000_000_000)  # a user that the system does not know
    with pytest.raises(FileError, match="no home folder"):
        units_folder({})
