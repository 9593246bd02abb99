"""Library and agent look in one place, and the library tells the true reason if it has no agent."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import pytest

from pqsec_pki.plugin import AgentFolder, stop_agent
from pqsec_pki.plugin import agent_folder as place_module
from pqsec_pki.plugin.building import SOURCES
from pqsec_pki.plugin.control import Client
from tests.interop.cyclone import RefusedError, participant
from tests.interop.plugin.test_plugin_robust import HERE, compiled
from tests.unit.plugin_wire import with_room_for

pytestmark = pytest.mark.interop


@pytest.fixture
def run_user(tmp_path, monkeypatch):
    monkeypatch.setattr(place_module, "_RUN_USER", tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture
def asked(requires, tmp_path, run_user):
    """asked(environment) is what the library says, and how it ended."""
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")

    def build(python):
        words = [f'-DRUN_USER="{run_user}"', f'-DPQSEC_PYTHON="{python}"', "-I", SOURCES]
        return compiled(tmp_path / "place", *words, HERE / "place.c", *SOURCES.glob("*.c"))

    program = build("/x")

    def ask(environment, *, starts=None):
        done = subprocess.run(
            [build(starts), "start"] if starts else [program],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=20,
        )
        return done.stdout.strip(), done.returncode

    return ask


@pytest.fixture
def edges():
    """Homes that are just short enough for a socket in them, and too long."""
    root = tempfile.mkdtemp(prefix="pqsec-")
    found = [f"{root}/".ljust(size, "x") for size in (77, 78, 79)]
    for each in found:
        Path(each).mkdir()
    yield found
    shutil.rmtree(root)


@pytest.mark.slow
def test_library_and_agent_agree_where_it_is(asked, run_user, tmp_path, edges):
    home, link, shared = (tmp_path / name for name in ("home", "link", "shared"))
    home.mkdir(), shared.mkdir(), link.symlink_to(home)
    shared.chmod(0o775)
    homes = ["", "/", "here", "/nowhere", *map(str, (home, link, shared, f"{home}/")), *edges]
    runtimes = [None, "", "here", "/nowhere", str(home)]
    differ = []
    for systemds in (False, True):
        if systemds:
            (run_user / str(os.geteuid())).mkdir(parents=True)
        for each in homes:
            for runtime in runtimes:
                environment = {"HOME": each}
                if runtime is not None:
                    environment["XDG_RUNTIME_DIR"] = runtime
                place = AgentFolder.of(environment)
                said, ended = asked(environment)
                if ended or Path(said) != place.socket:
                    differ.append((environment, str(place.socket), said))
    assert differ == []


def test_what_another_user_made_first_is_told_with_the_way_out(asked, tmp_path):
    (tmp_path / "pqsec").mkdir(mode=0o777)
    (tmp_path / "pqsec").chmod(0o777)
    said, ended = asked({"XDG_RUNTIME_DIR": str(tmp_path)})
    assert ended
    assert "is not a folder of this user's alone" in said
    assert "HOME or XDG_RUNTIME_DIR" in said


@pytest.mark.slow
def test_an_interpreter_that_cannot_be_executed_is_told_with_the_true_reason(asked, tmp_path):
    """It was told as gone where it stood, for root or another user alone."""
    runtime, python = tmp_path / "runtime", tmp_path / "python"
    runtime.mkdir()
    python.write_text("#!/bin/sh\n")
    python.chmod(0o644)
    environment = {"XDG_RUNTIME_DIR": str(runtime)}
    (tmp_path / "ring").symlink_to(tmp_path / "ring")
    paths = {
        "gone": tmp_path / "nowhere",
        "no folder": python / "below",
        "not executable": python,
        "a ring": tmp_path / "ring",
    }
    found = {name: asked(environment, starts=path) for name, path in paths.items()}
    gone = "no longer exists: run `pqsec plugin install` again"
    denied = (
        f"pqsec: user {os.geteuid()} may not execute {python}, or enter a folder above it: run"
        " `pqsec plugin install` with an interpreter for all users"
    )
    assert found == {
        "gone": (f"pqsec: {tmp_path / 'nowhere'} {gone}", 1),
        "no folder": (f"pqsec: {python / 'below'} {gone}", 1),
        "not executable": (denied, 1),
        "a ring": (
            f"pqsec: {tmp_path / 'ring'} cannot be executed: Too many levels of symbolic links",
            1,
        ),
    }


_SHOWS = "#!/bin/sh\nenv > {0}.new\nmv {0}.new {0}\n"  # instead of the agent
_VARIABLES = {
    "PQSEC_PKCS11_MODULE": "/lib/tokens.so",
    "PQSEC_PIN_FILE": "/pin",
    "LC_ALL": "de_DE",
    "TZ": "Asia/Tokyo",
    "LD_PRELOAD": "",
    "OPENSSL_CONF": "/nowhere",
    "PYTHONPATH": "/nowhere",
}


def environment_of_agent(program, tmp_path):
    """The variables of an agent that `program` starts."""
    shown = tmp_path / "shown"
    (tmp_path / "runtime").mkdir()
    (tmp_path / "python").write_text(_SHOWS.format(shown))
    (tmp_path / "python").chmod(0o755)
    environment = {"XDG_RUNTIME_DIR": str(tmp_path / "runtime"), "HOME": "/nowhere", **_VARIABLES}
    subprocess.run([program, "start"], env=environment, check=True, timeout=20)
    end = time.monotonic() + 60
    while not shown.exists() and time.monotonic() < end:
        time.sleep(0.01)
    found = dict(line.split("=", 1) for line in shown.read_text().splitlines())
    return {name: value for name, value in found.items() if name not in {"PWD", "_", "OLDPWD"}}


@pytest.mark.slow
def test_an_agent_gets_no_variable_that_later_hosts_should_not_have(asked, tmp_path):
    """In another locale, Python encoded the paths of all later hosts in another way."""
    asked({"XDG_RUNTIME_DIR": "/nowhere"}, starts=tmp_path / "python")
    assert environment_of_agent(tmp_path / "place", tmp_path) == {
        "HOME": "/nowhere",
        "XDG_RUNTIME_DIR": str(tmp_path / "runtime"),
        "PQSEC_PKCS11_MODULE": "/lib/tokens.so",
        "PQSEC_PIN_FILE": "/pin",
    }


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a program of another group")
def test_who_runs_a_program_with_more_rights_does_not_choose_what_its_agent_loads(
    asked, run_user, tmp_path
):
    """The library for tokens that PQSEC_PKCS11_MODULE names runs in the agent."""
    (run_user / str(os.geteuid())).mkdir(parents=True)
    asked({"XDG_RUNTIME_DIR": "/nowhere"}, starts=tmp_path / "python")
    program = tmp_path / "place"
    os.chown(program, 0, 65534)
    program.chmod(0o2755)
    assert environment_of_agent(program, tmp_path) == {}


@pytest.mark.slow
def test_the_library_and_the_agent_say_in_the_same_way_which_files_they_see(shim, labs):
    with participant(shim.folder, labs("pq").alice):
        agent = shim.wait_for_agent()
        with closing(Client(shim.place, "authentication")):
            assert shim.wait_for_agent() == agent
    with participant(shim.folder, labs("pq").bob):
        assert shim.wait_for_agent() == agent


def test_a_full_agent_tells_the_library_that_it_is_full(shim, labs):
    """It hung up, and the library said that the agent was gone."""
    stop_agent(shim.place)
    command = (sys.executable, "-I", "-m", "pqsec_pki.plugin", shim.place.socket, "300")
    agent = subprocess.Popen([*with_room_for(16), *command], stderr=subprocess.DEVNULL)
    try:
        shim.wait_for_agent()
        guests = [Client(shim.place, "authentication") for _ in range(16)]
        for _ in range(5):  # whether it hangs up before the library has greeted, or after
            with (
                pytest.raises(
                    RefusedError, match="the agent is full: 16 connections are the maximum"
                ),
                participant(shim.folder, labs("pq").alice),
            ):
                pass
        for guest in guests:
            guest.close()
    finally:
        agent.kill()
        agent.wait()
