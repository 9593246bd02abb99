"""How long the library waits for an agent that is busy, that hangs, and that is busy for ever."""

import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from itertools import repeat
from pathlib import Path

import pytest

from pqsec_pki.plugin import AgentFolder, stop_agent
from pqsec_pki.plugin.building import SOURCES
from pqsec_pki.plugin.calls import WORKING
from pqsec_pki.plugin.connection import GREETED
from tests.interop.plugin.test_plugin_robust import HERE, compiled

pytestmark = pytest.mark.interop

HANDLE = 7
ANSWER = struct.pack("<IBIQ", 13, 0, 0, HANDLE)


@pytest.fixture(scope="module")
def program(requires, tmp_path_factory):
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    words = ['-DPQSEC_PYTHON="/x"', "-I", SOURCES]
    path = tmp_path_factory.mktemp("patience") / "patience"
    return compiled(path, *words, HERE / "patience.c", *SOURCES.glob("*.c"))


@pytest.fixture
def said(program):
    """said(frames, patience) is what the library says that waits so many seconds, of an agent that
    answers with these, one in each eighth of them; it hangs up when all are sent."""
    folder = Path(tempfile.mkdtemp(prefix="pqsec-"))  # a socket's path must be short
    (folder / "pqsec").mkdir(mode=0o700)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(folder / "pqsec" / "agent.sock"))
    listener.listen()

    def ask(frames, patience):
        done = threading.Event()

        def answer():
            link, _ = listener.accept()
            with link, suppress(BrokenPipeError):  # who has given up has hung up
                link.recv(1 << 16)
                link.sendall(GREETED)
                link.recv(1 << 16)
                for each in frames:
                    if done.wait(patience / 8):
                        return
                    link.sendall(each)

        agent = threading.Thread(target=answer)
        agent.start()
        environment = {
            "XDG_RUNTIME_DIR": str(folder),
            "PQSEC_AGENT_TIMEOUT": str(int(1000 * patience)),
        }
        found = subprocess.run(
            [program], env=environment, capture_output=True, text=True, check=True
        )
        done.set()
        agent.join()
        return found.stdout

    yield ask
    listener.close()
    shutil.rmtree(folder)


@pytest.mark.slow
def test_a_busy_agent_gets_more_time_than_a_call_may_take(said):
    """At a robot's start, the agent was taken for one that hangs after five seconds."""
    assert said([*[WORKING] * 12, ANSWER], 2) == f"{HANDLE}\n"


def test_an_agent_that_says_nothing_is_not_waited_for(said):
    assert "does not answer within 400 ms" in said([*[b""] * 16, ANSWER], 0.4)


@pytest.mark.slow
def test_an_agent_that_is_busy_for_ever_is_given_up(said):
    assert "is too busy: no answer within 12000 ms" in said(repeat(WORKING), 1)


def test_an_agent_that_is_busy_and_then_ends_is_gone(said):
    assert "the agent is gone" in said([WORKING] * 3, 2)


# Counts how often it is started as the agent's interpreter: $5 is the socket.
COUNTING = '#!/bin/sh\necho >> "${{5%/*}}/starts"\nexec {python} "$@"\n'


@pytest.fixture
def together(requires, tmp_path):
    """together(variables) is what hosts with each of these say that start at once, and how many
    agents they start."""
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    python = tmp_path / "python"
    python.write_text(COUNTING.format(python=sys.executable))
    python.chmod(0o755)
    words = [f'-DPQSEC_PYTHON="{python}"', "-I", SOURCES]
    program = compiled(tmp_path / "host", *words, HERE / "patience.c", *SOURCES.glob("*.c"))
    runtime = Path(tempfile.mkdtemp(prefix="pqsec-"))  # a socket's path must be short
    given = {"XDG_RUNTIME_DIR": str(runtime), "PQSEC_AGENT_TIMEOUT": "60000"}
    place = AgentFolder.of(given)

    def start(variables):
        hosts = [
            subprocess.Popen([program], env=given | each, stdout=subprocess.PIPE, text=True)
            for each in variables
        ]
        said = [each.communicate()[0] for each in hosts]
        return said, len((place.folder / "starts").read_text())

    yield start
    stop_agent(place)
    shutil.rmtree(runtime)


@pytest.mark.slow
def test_hosts_that_start_together_start_one_agent(together):
    """Each of 100 hosts started a Python of its own, which kept two cores busy for seconds."""
    assert together([{}] * 8) == (["0\n"] * 8, 1)


def test_hosts_that_one_agent_cannot_serve_are_served_when_they_start_together(together):
    """Each second one failed: an agent of another host took the place of its own."""
    hosts = [{"PQSEC_PIN_FILE": f"/{number}"} for number in range(4)]
    said, starts = together(hosts)
    assert (said, starts >= 4) == (["0\n"] * 4, True)


@pytest.mark.slow
def test_a_peer_that_no_agent_can_validate_leaves_a_token_that_the_stack_can_read(
    requires, tmp_path
):
    """Cyclone DDS 0.10.2 crashed where the peer's Request came before our AuthRequest."""
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    words = ['-DPQSEC_PYTHON="/x"', "-I", SOURCES]
    program = compiled(tmp_path / "failed", *words, HERE / "failed.c", *SOURCES.glob("*.c"))
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert said == "1 '' pqsec: the agent was lost; create the participant again\n"
