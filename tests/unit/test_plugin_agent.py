"""The agent as a process: who may connect, when it ends, and what one guest can do to others."""

import os
import re
import resource
import shutil
import socket
import stat
import struct
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

import pqsec_pki
from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.errors import FileError, MalformedError
from pqsec_pki.plugin import (
    AgentFolder,
    agent_status,
    control,
    listening,
    retired_agents,
    stop_agent,
)
from pqsec_pki.plugin import agent_folder as place_module
from pqsec_pki.plugin import staying as staying_module
from pqsec_pki.plugin.__main__ import MAX_LOG
from pqsec_pki.plugin.calls import VERSION
from pqsec_pki.plugin.control import Client
from pqsec_pki.plugin.incoming import MAX_GREETING
from pqsec_pki.plugin.listening import peer
from pqsec_pki.plugin.server import MAX_CONNECTIONS
from tests.unit.plugin_wire import framed, greeting, with_room_for

PATIENCE = 120


@pytest.fixture
def place():
    """A place of this test's own; a socket's path must be short."""
    folder = Path(tempfile.mkdtemp(prefix="pqsec-"))
    yield AgentFolder(folder / "agent.sock")
    shutil.rmtree(folder)


@pytest.fixture
def tmp_path():
    """Short, too: a home in it takes a socket."""
    with tempfile.TemporaryDirectory(prefix="pqsec-") as folder:
        yield Path(folder)


def start(place, *idle, runner=()):
    return subprocess.Popen(
        [*runner, sys.executable, "-I", "-m", "pqsec_pki.plugin", place.socket, *idle],
        stderr=subprocess.PIPE,
        text=True,
    )


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


@contextmanager
def running(place, *idle, runner=()):
    process = start(place, *idle, runner=runner)
    try:
        until(lambda: agent_status(place))
        yield process
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def connected(place, octets=b""):
    link = socket.socket(socket.AF_UNIX)
    link.settimeout(PATIENCE)
    link.connect(str(place.socket))
    with suppress(BrokenPipeError):  # who is refused may be told so before it has asked
        link.sendall(octets)
    return link


def test_an_agent_is_for_its_user_alone_and_ends_when_told(place):
    with running(place) as process:
        assert stat.S_IMODE(place.socket.stat().st_mode) == 0o600
        status = agent_status(place)
        assert (status.process, status.socket) == (process.pid, str(place.socket))
        assert status.connections == ()
        assert stop_agent(place)
        assert not place.socket.exists()  # so the next one can come at once
        assert process.wait(PATIENCE) == 0
    assert not stop_agent(place)


def test_an_agent_tells_whom_it_serves(place):
    with running(place):
        guest = Client(place, "authentication")
        (found,) = agent_status(place).connections
        name = Path("/proc/self/comm").read_text().strip()
        assert found == {
            "process": f"{name}[{os.getpid()}]",
            "plugin": "authentication",
            "objects": 0,
        }
        guest.close()
        until(lambda: agent_status(place).connections == ())


def test_a_process_cannot_write_lines_of_its_own_into_the_log(place):
    comm = Path("/proc/self/comm")
    before = comm.read_text()
    with running(place) as process:
        comm.write_text("ours\nand mine")
        try:
            guest = Client(place, "authentication")
            with pytest.raises(MalformedError):
                guest.call("get_identity_token", 1)
        finally:
            comm.write_text(before.strip())
        (found,) = agent_status(place).connections
        guest.close()
        process.terminate()
        said = process.stderr.read()
    assert found["process"] == f"ours\\u000aand mine[{os.getpid()}]"
    assert "\nand mine" not in said


def test_an_agent_leaves_no_core_file_and_has_files_enough(place):
    with running(place) as process:
        limits = Path(f"/proc/{process.pid}/limits").read_text()
        assert re.search(r"Max core file size +0 +0 ", limits)
        assert int(re.search(r"Max open files +([0-9]+)", limits)[1]) > MAX_CONNECTIONS


def test_an_agent_with_more_files_than_enough_keeps_them(place):
    with running(place, runner=("sh", "-c", 'ulimit -n 2048; exec "$@"', "sh")) as process:
        assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE) == (2048, 2048)


def test_there_is_one_agent(place):
    with running(place) as first:
        second = start(place)
        assert second.wait(PATIENCE) == 0
        assert "listening" not in second.stderr.read()
        second.stderr.close()
        assert agent_status(place).process == first.pid


def test_only_one_agent_at_a_time_comes_or_goes(tmp_path, monkeypatch):
    monkeypatch.setattr(listening, "LOCK_SECONDS", 0.05)
    lock, refused = tmp_path / "lock", pytest.raises(FileError, match="another agent has locked it")
    with listening.lock(lock), refused, listening.lock(lock):
        pass
    with listening.lock(lock):
        pass


def test_an_agent_that_goes_in_the_middle_of_its_answer_is_told(place):
    place.prepare()
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(place.socket))
        listener.listen()

        def answer():
            link, _ = listener.accept()
            with link:
                link.recv(1000)
                link.send(b"\x09\0\0\0\0")  # one octet of nine

        with ThreadPoolExecutor(1) as pool:
            pool.submit(answer)
            assert agent_status(place) is None


def test_an_agent_takes_the_place_of_one_that_was_killed(place):
    with running(place) as first:
        first.kill()
        first.wait()
        assert place.socket.exists()
        assert agent_status(place) is None
        with running(place) as second:
            assert agent_status(place).process == second.pid


def test_an_agent_whose_socket_was_deleted_is_replaced_and_leaves_the_next_one_alone(place):
    """As what cleans /tmp might do. Its guests stay with it."""
    with running(place) as first:
        guest = Client(place, "control")
        place.socket.unlink()
        with running(place) as second:
            assert agent_status(place).process == second.pid
            guest.call("stop")
            assert first.wait(PATIENCE) == 0
            assert agent_status(place).process == second.pid
        guest.close()


def test_an_idle_agent_ends_but_not_while_somebody_is_there(place):
    with running(place, "1") as process:
        guest = Client(place, "access_control")
        time.sleep(1.5)
        assert process.poll() is None
        guest.close()
        assert process.wait(PATIENCE) == 0


# The agent as a host starts it, which looks often whether it should stay.
_STAYING = (
    "import sys; sys.path.insert(0, sys.argv.pop(1))\n"
    "from pqsec_pki.plugin import __main__ as agent, server\n"
    "agent.IDLE_SECONDS = server._GRACE_SECONDS = server._QUIET = 0.1\n"
    "agent.start()\n"
)


@contextmanager
def staying(place, site, *more, **environment):
    """An agent whose program is installed in `site`."""
    for name in ("pqsec_pki", *more):
        site.joinpath(name).symlink_to(Path(pqsec_pki.__file__).parents[1] / name)
    command = [sys.executable, "-c", _STAYING, site, place.socket]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env=os.environ | environment
    )
    try:
        until(lambda: agent_status(place))
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("change", ["another program", "no socket"])
def test_an_agent_without_hosts_stays_until_it_is_no_longer_the_users(place, tmp_path, change):
    """The first participant after a pause waited for a whole start: 0.2 s."""
    with staying(place, tmp_path, "schemas") as process:
        time.sleep(0.6)
        assert agent_status(place).process == process.pid
        if change == "no socket":
            place.socket.unlink()
        else:
            tmp_path.joinpath("pqsec-9.dist-info").mkdir()
        assert process.wait(PATIENCE) == 0


def replace(path):
    """As an installation does: another file of the same content takes its place."""
    fresh = path.with_suffix(".new")
    shutil.copy(path, fresh)
    fresh.replace(path)


def installed_anew(site):
    """Another pqsec takes the place of that in `site`."""
    other = site / "other"
    shutil.copytree(Path(pqsec_pki.__file__).parent, other, ignore=lambda *_: {"__pycache__"})
    site.joinpath("pqsec_pki").unlink()
    other.rename(site / "pqsec_pki")


def is_turned_away(place):
    """Whether a host is told nothing, so that the library starts an agent."""
    with pytest.raises(FileError, match="the agent does not answer"):
        Client(place, "authentication")
    return agent_status(place) is None


def test_the_next_host_is_not_served_by_a_program_that_was_replaced(place, tmp_path):
    """As long as one host stayed, or the next came within five minutes, all were: also after an
    update that cured a flaw."""
    with staying(place, tmp_path, "schemas") as process:
        host = Client(place, "authentication")
        installed_anew(tmp_path)
        assert is_turned_away(place)
        with running(place) as second:
            assert agent_status(place).process == second.pid
            with pytest.raises(MalformedError, match="does not know the handle"):
                host.call("get_identity_token", 1)  # it keeps the agent that has its keys
            host.close()
            assert process.wait(PATIENCE) == 0
            assert agent_status(place).process == second.pid


def test_an_agent_that_serves_no_new_hosts_is_shown_with_its_hosts_and_stopped(place, tmp_path):
    """Nobody saw that hosts still used the version before an update, or which."""
    with staying(place, tmp_path, "schemas") as process:
        assert agent_status(place).notice == ""
        host = Client(place, "authentication")
        installed_anew(tmp_path)
        assert agent_status(place).notice.startswith("another version was installed: restart")
        assert is_turned_away(place)
        (found,) = retired_agents(place)
        assert (found.process, len(found.connections)) == (process.pid, 1)
        assert found.notice == (
            "another version was installed: restart these hosts, which use the previous one"
        )
        assert Path(found.socket).name == f"retired-{process.pid}.sock"
        late = AgentFolder(Path(found.socket))
        with pytest.raises(FileError, match="the agent does not answer"):
            Client(late, "authentication")  # it answers the command line alone
        with running(place) as second:
            assert agent_status(place).process == second.pid
            assert [each.process for each in retired_agents(place)] == [process.pid]
            assert stop_agent(place)
            assert [each.wait(PATIENCE) for each in (process, second)] == [0, 0]
        assert retired_agents(place) == []
        assert list(place.folder.glob("*.sock")) == []
        host.close()


def test_an_agent_that_hangs_keeps_no_other_from_being_stopped(place, monkeypatch):
    """Those after it went on, with their keys."""
    last = AgentFolder(place.folder / "retired-2.sock")
    with running(last) as process, listening.bound(place.folder / "retired-1.sock"):
        monkeypatch.setattr(control, "_SECONDS", 2)  # the other has so many too
        with pytest.raises(FileError, match="the agent does not answer"):
            stop_agent(place)
        assert process.wait(PATIENCE) == 0


def test_an_agent_that_has_retired_leaves_no_socket_when_its_hosts_have_gone(place, tmp_path):
    with staying(place, tmp_path, "schemas") as process:
        host = Client(place, "authentication")
        installed_anew(tmp_path)
        assert is_turned_away(place)
        host.close()
        assert process.wait(PATIENCE) == 0
        assert list(place.folder.glob("retired-*")) == []


def test_a_socket_of_a_killed_agent_that_had_retired_is_removed_by_the_next(place):
    left = place.folder / "retired-7.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(left))
    assert retired_agents(place) == []
    with running(place):
        assert not left.exists()


def test_an_agent_that_cannot_be_shown_still_retires(place, tmp_path):
    with staying(place, tmp_path, "schemas") as process:
        host = Client(place, "authentication")
        (place.folder / f"retired-{process.pid}.sock").mkdir()
        installed_anew(tmp_path)
        assert is_turned_away(place)
        host.close()
        assert process.wait(PATIENCE) == 0
        assert "it is not shown by `pqsec agent status`" in process.stderr.read()


def test_a_library_of_another_version_gets_the_agent_that_was_installed_with_it(place, tmp_path):
    """It was told to stop the one before, which could stay for ever."""
    with staying(place, tmp_path, "schemas"):
        host = Client(place, "authentication")
        installed_anew(tmp_path)
        with connected(place, greeting("authentication", version=VERSION + 1)) as link:
            assert link.recv(100) == b""
        host.close()


@pytest.mark.parametrize("has_host", [True, False])
def test_an_agent_does_not_outlive_a_library_that_was_replaced(place, tmp_path, has_host):
    """An update of OpenSSL, Python or lxml reached no participant before a logout."""
    maps = Path("/proc/self/maps").read_text()
    library = tmp_path / "lib" / "libany.so"
    library.parent.mkdir()
    shutil.copy(re.search(r"r-xp .* (/\S+/libm\S+)", maps)[1], library)
    with staying(place, tmp_path, "schemas", LD_PRELOAD=str(library)) as process:
        host = Client(place, "authentication") if has_host else None
        replace(library)
        if host:
            assert is_turned_away(place)
            host.close()
        assert process.wait(PATIENCE) == 0


_AT = "7f0000000000-7f0000001000 {} 00000000 fe:01 42  {}\n"


@pytest.mark.parametrize(
    ("line", "is_old"),
    [
        (_AT.format("r-xp", "/usr/lib/libssl.so.3 (deleted)"), True),
        (_AT.format("r-xp", "/usr/lib/libssl.so.3"), False),
        (_AT.format("r--p", "/usr/lib/locale/locale-archive (deleted)"), False),
        (_AT.format("r-xp", "/memfd:libffi (deleted)"), False),  # it has no file
        (_AT.format("r-xp", "/opt/removed before.so (deleted)"), False),
    ],
)
def test_only_a_program_or_library_that_was_replaced_since_counts(
    monkeypatch, tmp_path, line, is_old
):
    maps = tmp_path / "maps"
    monkeypatch.setattr(staying_module, "_MAPS", maps)
    before = _AT.format("r-xp", "/opt/removed before.so (deleted)")
    maps.write_text(before)
    found = staying_module.replaced()
    maps.write_text(before + line)
    assert found() is is_old
    maps.unlink()  # as in a container without /proc
    assert not found()


def test_later_workers_share_what_the_first_participant_did_not_wait_for(place, tmp_path):
    """Each loaded lxml for itself."""
    with staying(place, tmp_path, "schemas") as process:
        until(lambda: "lxml/etree" in Path(f"/proc/{process.pid}/maps").read_text())


def test_an_installation_that_lacks_something_does_not_end_the_agent(place, tmp_path):
    """It may be replaced in that moment."""
    with staying(place, tmp_path) as process:
        said = [process.stderr.readline() for _ in range(2)]
        assert "later workers load it themselves: schemas/" in said[1]
        assert agent_status(place).process == process.pid


def test_workers_of_one_agent_have_no_random_numbers_in_common():
    code = (
        "import os, random, secrets\n"
        "from pqsec_pki.algorithms import KEY_AGREEMENTS\n"
        "from pqsec_pki.plugin import __main__, staying\n"
        "staying.load_the_rest(print)\n"
        "for _ in range(2):\n"
        "    if not os.fork():\n"
        "        for row in KEY_AGREEMENTS:\n"
        "            print(row.generate().public.hex(), flush=True)\n"
        "        print(secrets.token_hex(), random.random(), sep='\\n', flush=True)\n"
        "        os._exit(0)\n"
        "    os.wait()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = done.stdout.split()
    assert len(found) == len(set(found)) == 2 * (len(KEY_AGREEMENTS) + 2)


@pytest.mark.parametrize("mode", [0o755, 0o770])
def test_a_folder_that_others_can_enter_is_refused(place, mode):
    place.folder.chmod(mode)
    process = start(place)
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 3
    assert "is not a folder of this user's alone" in said
    with pytest.raises(FileError, match="is not a folder of this user's alone"):
        place.prepare()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
@pytest.mark.parametrize("ask", [agent_status, stop_agent])
def test_the_folder_of_another_user_is_not_asked(place, ask):
    """As somebody may have made it in /tmp, with a socket that gives bad answers."""
    os.chown(place.folder, 65534, 65534)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(place.socket))
        listener.listen()
        listener.settimeout(0)
        with pytest.raises(FileError, match="is not a folder of this user's alone"):
            ask(place)
        with pytest.raises(BlockingIOError):
            listener.accept()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_another_user_is_not_served_even_where_the_folder_lets_it_in(place):
    with running(place) as process:
        place.folder.chmod(0o755)
        place.socket.chmod(0o666)
        script = (
            "import os, socket, sys; os.setuid(65534)\n"
            f"link = socket.socket(socket.AF_UNIX); link.settimeout({PATIENCE})\n"
            "link.connect(sys.argv[1])\n"
            "print(link.recv(1))"
        )
        command = [sys.executable, "-c", script, place.socket]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stdout == "b''\n"
        place.folder.chmod(0o700)
        assert agent_status(place)
        process.terminate()
        assert "of user 65534 is not served" in process.stderr.read()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_a_user_with_a_large_number_is_known():
    """As in a user namespace: more than a signed number holds."""
    child = os.fork()
    if child == 0:
        os.setuid(3_000_000_000)
        one, _other = socket.socketpair()
        os._exit(peer(one) != (os.getpid(), os.geteuid()))
    assert os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize(
    "octets",
    [b"", b"\0", b"\xff" * 100, greeting("authentication")[:9], framed(b"nonsense")],
)
def test_one_guest_cannot_keep_another_from_being_served(place, octets):
    with running(place), connected(place, octets):
        client = Client(place, "authentication")
        with pytest.raises(MalformedError, match="does not know the handle"):
            client.call("get_identity_token", 1)
        client.close()


def test_who_sends_what_is_not_the_protocol_is_told_in_the_log_and_who_hangs_up_is_not(place):
    with running(place) as process:
        connected(place).close()
        with connected(place, framed(b"nonsense")) as link:
            assert link.recv(1) == b""
        until(lambda: agent_status(place).connections == ())
        process.terminate()
        said = process.stderr.read().splitlines()
    [line] = [each for each in said if f"[{os.getpid()}]" in each]
    assert line.partition("]: ")[2]


@pytest.mark.parametrize("plugin", ["control", "authentication"])
def test_a_greeting_has_an_end(place, plugin):
    """What is more is no greeting, and is not kept in memory until it is complete."""
    body = greeting(plugin)[4:]
    with running(place):
        for octets in (framed(body + b"x"), (MAX_GREETING + 1).to_bytes(4, "little")):
            with connected(place, octets) as link:
                assert link.recv(1) == b""


def test_a_guest_that_does_not_read_its_answers_is_waited_for_by_nobody(place):
    with running(place), connected(place, greeting("control")) as deaf:
        deaf.settimeout(0.2)
        with pytest.raises(TimeoutError):
            deaf.sendall(framed(b"\6\0\0\0status") * 1_000_000)
        assert agent_status(place)


FALLBACK = Path(f"/tmp/pqsec-{os.geteuid()}")


@pytest.fixture
def run_user(tmp_path, monkeypatch):
    """What /run/user is here: without a folder of this user."""
    monkeypatch.setattr(place_module, "_RUN_USER", tmp_path / "run")
    return tmp_path / "run" / str(os.geteuid())


def folder_for(**environment):
    return AgentFolder.of({name: str(value) for name, value in environment.items()}).folder


def test_the_place_is_where_the_user_alone_can_be_first(tmp_path, run_user):
    home, runtime, link = tmp_path / "home", tmp_path / "runtime", tmp_path / "link"
    for each in (home, runtime):
        each.mkdir(mode=0o755)
    link.symlink_to(home)
    found = {
        "runtime first": folder_for(XDG_RUNTIME_DIR=runtime, HOME=home),
        "home": folder_for(HOME=home),
        "a link": folder_for(HOME=link),
        "runtime is none": folder_for(XDG_RUNTIME_DIR="/nowhere", HOME=home),
        "runtime is relative": folder_for(XDG_RUNTIME_DIR="here", HOME=home),
    }
    run_user.mkdir(parents=True)
    found["systemd's"] = folder_for(HOME=home)
    assert found == {
        "runtime first": runtime / "pqsec",
        "home": home / ".pqsec",
        "a link": link / ".pqsec",
        "runtime is none": home / ".pqsec",
        "runtime is relative": home / ".pqsec",
        "systemd's": run_user / "pqsec",
    }


@pytest.mark.usefixtures("run_user")
def test_a_home_where_another_can_be_first_or_no_socket_fits_is_none(tmp_path, monkeypatch):
    (tmp_path / "home").mkdir(mode=0o755)
    monkeypatch.chdir(tmp_path)  # where a home that is relative is there
    shared, deep = tmp_path / "shared", tmp_path / ("x" * 90)
    deep.mkdir()
    shared.mkdir()
    shared.chmod(0o775)
    (tmp_path / "file").touch()
    homes = (shared, deep, tmp_path / "file", "/", "", "home", "/nowhere", "/\0")
    assert [str(home) for home in homes if folder_for(HOME=home) != FALLBACK] == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_another_user_who_is_first_in_tmp_keeps_nobody_from_an_agent(tmp_path, run_user):
    """It could make /tmp/pqsec-UID, and every participant of that user was refused."""
    folder = run_user.parent / "pqsec"
    folder.mkdir(parents=True)
    os.chown(folder, 65534, 65534)
    (tmp_path / "home").mkdir()
    found = folder_for(HOME=tmp_path / "home")
    assert found == tmp_path / "home" / ".pqsec"
    AgentFolder(found / "agent.sock").prepare()
    with pytest.raises(FileError, match="not a folder of this user's alone") as refusal:
        AgentFolder(folder / "agent.sock").prepare()
    assert "HOME or XDG_RUNTIME_DIR" in refusal.value.hint


MOST = (
    b"the agent is full: 16 connections are the maximum, two for each domain of a DDS process:"
    b" 8 processes with one domain each"
)


def _refusal_of(link):
    """What it is told; b"" for who is served."""
    try:
        head = link.recv(5)
    except ConnectionResetError:
        return b"reset"
    if head == framed(b"\0"):
        return b""
    assert head[4:] == b"\1"
    (size,) = struct.unpack("<I", link.recv(4))
    return link.recv(size)


def test_more_connections_than_there_are_files_are_refused_and_those_that_are_stay(place):
    """Each needs files of its own too: keys are read when they are asked for."""
    with running(place, "300", runner=with_room_for(16)) as process:
        first = Client(place, "authentication")
        crowd = [connected(place, greeting("authentication")) for _ in range(60)]
        refused = list(filter(None, map(_refusal_of, crowd)))
        assert 40 < len(refused) < 60
        assert {each for each in refused if each != b"reset"} == {MOST}
        properties = (("dds.sec.auth.identity_certificate", "file:nowhere.pem"),)
        with pytest.raises(MalformedError, match="no such file"):
            first.call("validate_local_identity", 0, "/", properties, bytes(16))
        for link in crowd:
            link.close()
        until(lambda: len(agent_status(place).connections) == 1)
        first.close()
        process.terminate()
        said = process.stderr.read()
    assert "is not served: 16 connections are the maximum" in said
    assert said.count("is not served") == 1  # and the rest is counted


def _seconds_used(process):
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_an_agent_with_no_file_left_waits_and_then_serves_who_waits(place):
    """As where the whole system has none left."""
    with running(place) as process:
        files = Path(f"/proc/{process.pid}/fd")
        handles = 5  # three, the listener and the selector
        until(lambda: len(list(files.iterdir())) == handles)
        limits = resource.prlimit(process.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (handles, limits[1]))
        with connected(place, greeting("control")) as waiting:
            before = _seconds_used(process.pid)
            waiting.settimeout(1.2)
            with pytest.raises(TimeoutError):
                waiting.recv(1)
            assert _seconds_used(process.pid) - before < 0.2
            resource.prlimit(process.pid, resource.RLIMIT_NOFILE, limits)
            waiting.settimeout(PATIENCE)
            assert waiting.recv(5) == framed(b"\0")
        process.terminate()
        assert "no more processes can be served" in process.stderr.read()


_URGENT = (
    "import os, sys; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1));"
    "os.execv(sys.argv[1], sys.argv[1:])"
)


def test_an_agent_does_not_keep_a_hosts_priority(place):
    runner = (sys.executable, "-c", _URGENT)
    if subprocess.run([*runner, "/bin/true"], stderr=subprocess.DEVNULL, check=False).returncode:
        pytest.skip("nobody may have a priority of real time here")
    with running(place, runner=runner) as process:
        assert os.sched_getscheduler(process.pid) == os.SCHED_OTHER


def test_a_log_that_has_grown_loses_its_older_half(place):
    old = b"".join(b"%07d\n" % number for number in range(1 << 18))  # two megabytes
    place.log.write_bytes(old)
    with place.log.open("ab") as log:
        line = [sys.executable, "-I", "-m", "pqsec_pki.plugin", place.socket]
        process = subprocess.Popen(line, stderr=log)
    try:
        until(lambda: agent_status(place))
    finally:
        process.terminate()
        process.wait()
    kept = place.log.read_bytes()
    lines = kept.splitlines(keepends=True)
    assert len(kept) < MAX_LOG < len(old)
    assert b"".join(lines[:-1]) == old[-len(kept) + len(lines[-1]) :]
    assert b"listening at" in lines[-1]


def test_an_agent_loads_little_before_its_first_answer():
    """The first participant waits for it. Its worker loads lxml with the first document."""
    rooms = "access algorithms certificates credentials documents handshake plugin smime tokens"
    costly = (
        "argparse ast asyncio concurrent difflib http json logging multiprocessing ssl subprocess"
    )
    code = (
        "import sys; before = set(sys.modules); import pqsec_pki.plugin.__main__\n"
        "new = set(sys.modules) - before\n"
        "print(*sorted({each.partition('.')[0] for each in new} - sys.stdlib_module_names))\n"
        "print(*sorted(each[10:] for each in new if each.count('.') == 1 and each[:10] =="
        " 'pqsec_pki.' and hasattr(sys.modules[each], '__path__')))\n"
        f"print(*sorted(new & set({costly!r}.split())))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    outside, ours, others = done.stdout.splitlines()
    visible = {each for each in outside.split() if not each.startswith("_")}
    assert visible <= {"bcrypt", "cryptography", "pqsec_pki"}
    assert (ours, others) == (rooms, "ast")
