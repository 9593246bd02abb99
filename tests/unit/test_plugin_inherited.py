"""What an agent has of the host that started it, which must not harm a later host.

Agents and hosts are real processes, each with what its command line sets before it begins.
"""

import os
import re
import resource
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from pqsec_pki.plugin import AgentFolder, agent_status, listening, retired_agents
from pqsec_pki.plugin.control import Client
from tests.unit.test_plugin_agent import PATIENCE, until

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can start others' processes")

_MAY = int(re.findall(r"CapEff:\t(\w+)", Path("/proc/self/status").read_text())[0], 16)


def with_capability(number, name):
    """Root of a container lacks some."""
    return pytest.mark.skipif(not _MAY >> number & 1, reason=f"root has no {name} here")


mounts = with_capability(21, "CAP_SYS_ADMIN")
priorities = with_capability(23, "CAP_SYS_NICE")
NOBODY = 65534
# Both load their modules, run the test's statements, and only then begin: others than root may not
# read this Python.
_AGENT = (
    "import ctypes, os, resource, sys\n"
    "from pqsec_pki.plugin import __main__\n"
    "exec(sys.argv.pop(1))\n"
    "__main__.start()\n"
)
# Connects as a library does.
_HOST = (
    "import ctypes, os, resource, sys\n"
    "from pathlib import Path\n"
    "from pqsec_pki.errors import FileError\n"
    "from pqsec_pki.plugin import AgentFolder\n"
    "from pqsec_pki.plugin.control import Client\n"
    "place = AgentFolder(Path(sys.argv[2]))\n"
    "exec(sys.argv[1])\n"
    "try:\n"
    "    Client(place, 'authentication')\n"
    "except FileError as error:\n"
    "    sys.exit(str(error))\n"
)
# Starts an agent as a library does, and connects when it is told to.
_STARTER = (
    "import ctypes, os, resource, sys\n"
    "from pathlib import Path\n"
    "from pqsec_pki.plugin import AgentFolder, __main__\n"
    "from pqsec_pki.plugin.control import Client\n"
    "exec(sys.argv[1])\n"
    "assert not ctypes.CDLL(None).prctl(36, 1)\n"  # its agent stays its child
    "if not (agent := os.fork()):\n"
    "    os._exit(__main__.main(['--detach', sys.argv[2]]))\n"
    "os.waitpid(agent, 0)\n"
    "print('listens', flush=True)\n"
    "for line in sys.stdin:\n"
    "    exec(line)\n"
    "    Client(AgentFolder(Path(sys.argv[2])), 'authentication')\n"
    "    print('served', flush=True)\n"
    "for agent in Path('/proc/thread-self/children').read_text().split():\n"
    "    os.kill(int(agent), 9)\n"
)
# What they do before they begin.
OTHER_MOUNTS = "assert not ctypes.CDLL(None).unshare(0x20000)"
OTHER_ROOT = "os.chroot(place.folder); place = AgentFolder(Path('/agent.sock'))"
NO_PROC = f"""
{OTHER_MOUNTS}
mount = ctypes.CDLL(None).mount
assert mount(None, b"/", None, 0x44000, None) == 0  # private
assert mount(b"none", b"/proc", b"tmpfs", 0, None) == 0
"""
# Its filter allows all calls.
FILTER = """
import struct
program = ctypes.create_string_buffer(struct.pack("HBBI", 6, 0, 0, 0x7FFF0000))
class Filter(ctypes.Structure):
    _fields_ = [("size", ctypes.c_ushort), ("program", ctypes.c_void_p)]
found, prctl = Filter(1, ctypes.addressof(program)), ctypes.CDLL(None).prctl
assert prctl(38, 1, 0, 0, 0) == 0 == prctl(22, 2, ctypes.byref(found))
"""
DROPPED = """
head, sets = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
assert not ctypes.CDLL(None).capget(head, sets)
sets[0], sets[1] = sets[0] & ~2, sets[1] & ~2  # CAP_DAC_OVERRIDE
assert not ctypes.CDLL(None).capset(head, sets)
"""


def as_nobody(*more, groups=(100,), group=100):
    """With these groups; `more` comes first."""
    user = f"os.setgroups({[*groups]}); os.setgid({group}); os.setuid({NOBODY})"
    return "; ".join((*more, user))


def limit(kind, value):
    """A hard limit."""
    return f"resource.setrlimit(resource.RLIMIT_{kind}, ({value}, {value}))"


@pytest.fixture
def place():
    """A place that its user alone can enter; a socket's path must be short."""
    with tempfile.TemporaryDirectory(prefix="pqsec-") as folder:
        yield AgentFolder(Path(folder) / "agent.sock")


def python(code, prelude, place):
    return [sys.executable, "-c", code, prelude, place.socket]


@contextmanager
def running(place, prelude="", **variables):
    """An agent that stays for later hosts, of whatever user."""
    if "setuid" in prelude:
        os.chown(place.folder, NOBODY, NOBODY)
    process = subprocess.Popen(
        python(_AGENT, prelude, place),
        env=environment(variables),
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        until(lambda: process.poll() is not None or listening.answers(place.socket))
        assert process.poll() is None, process.stderr.read()
        yield process
    finally:
        process.kill()
        process.communicate()


def environment(variables):
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | variables


def host(place, prelude="", **variables):
    """What a host is told that connects to the agent: "" if it is served."""
    done = subprocess.run(
        python(_HOST, prelude, place),
        env=environment(variables),
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    return done.stderr.strip()


TURNED_AWAY = "the agent does not answer"


@contextmanager
def agent(place, prelude="", **variables):
    """One that stays for later hosts, and has served one."""
    with running(place, prelude, **variables) as process:
        assert host(place, prelude, **variables) == ""
        yield process


@pytest.mark.parametrize("kind", ["AS", "CPU", "DATA", "FSIZE", "NPROC"])
def test_a_hosts_own_limits_do_not_end_or_hinder_the_agent(place, kind):
    """A host with `ulimit -S -t 9` got an agent that the system killed, with all its hosts."""
    number = getattr(resource, f"RLIMIT_{kind}")
    hard = resource.getrlimit(number)[1]
    soft = f"resource.setrlimit({number}, ({2 << 30 if kind in {'AS', 'DATA'} else 900}, {hard}))"
    with running(place, soft) as process:
        assert resource.prlimit(process.pid, number) == (hard, hard)


@priorities
@pytest.mark.parametrize("nice", [-5, 5])
def test_a_hosts_nice_value_is_not_the_agents(place, nice):
    with running(place, f"os.nice({nice})") as process:
        assert os.getpriority(os.PRIO_PROCESS, process.pid) == 0


@pytest.mark.parametrize("before", ["", pytest.param(NO_PROC, marks=mounts)])
def test_a_hosts_capabilities_are_not_the_agents(place, before):
    """Files that only such a host may read were read for all of the user's hosts."""
    keeps = f"{before}\nctypes.CDLL(None).prctl(8, 1)"
    with running(place, as_nobody(keeps)) as process:
        status = Path(f"/proc/{process.pid}/status").read_text()
    assert "CapPrm:\t0000000000000000" in status


@pytest.mark.parametrize("other", [pytest.param(OTHER_MOUNTS, marks=mounts), OTHER_ROOT])
def test_a_host_that_sees_other_files_is_not_served_with_those_of_the_first(place, other):
    """Paths in its configuration named other files: it got another participant's identity."""
    with agent(place):
        assert host(place) == ""
        assert TURNED_AWAY in host(place, other)
        assert agent_status(place) is None


@mounts
def test_a_host_is_not_served_by_an_agent_of_another_mount_name_space(place):
    with running(place, OTHER_MOUNTS):
        assert TURNED_AWAY in host(place)


@pytest.mark.parametrize(
    ("first", "second"),
    [((100, 200), (100,)), ((100,), (100, 200)), ((100,), (200,))],
)
def test_a_host_with_other_groups_is_not_served_with_the_rights_of_the_first(place, first, second):
    """It could use keys that its groups may not read, or was refused its own."""
    with agent(place, as_nobody(groups=first)):
        assert host(place, as_nobody(groups=first)) == ""
        assert TURNED_AWAY in host(place, as_nobody(groups=second))


def test_a_host_with_another_first_group_is_not_served_with_the_rights_of_the_first(place):
    with agent(place, as_nobody()):
        assert TURNED_AWAY in host(place, as_nobody(group=200))


def test_a_host_with_higher_limits_is_not_served_under_lower_ones(place):
    low, lower = (as_nobody(limit("AS", size << 30)) for size in (4, 3))
    with agent(place, low):
        assert host(place, low) == host(place, lower) == ""
        assert TURNED_AWAY in host(place, as_nobody())


def test_a_host_with_more_files_than_an_agent_can_use_is_served(place):
    few, enough, more = (as_nobody(limit("NOFILE", files)) for files in (512, 1024, 2048))
    with agent(place, enough):
        assert host(place, more) == ""
    with agent(place, few):
        assert TURNED_AWAY in host(place, enough)


@priorities
@pytest.mark.parametrize(
    "low",
    [
        "os.setpriority(os.PRIO_PROCESS, 0, 19)",
        "os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))",
    ],
)
def test_a_host_with_a_higher_priority_does_not_wait_for_an_agent_with_a_low_one(place, low):
    """Under load, calls of later hosts took longer than the time that they have."""
    low = as_nobody("resource.setrlimit(resource.RLIMIT_NICE, (0, 0))", low)
    with agent(place, low):
        assert host(place, low) == ""
        assert TURNED_AWAY in host(place, as_nobody("os.setpriority(os.PRIO_PROCESS, 0, 0)"))


@priorities
def test_an_agent_needs_no_higher_priority_than_usual(place):
    usual, high = (as_nobody(f"os.setpriority(os.PRIO_PROCESS, 0, {nice})") for nice in (0, -5))
    with agent(place, usual):
        assert host(place, high) == ""


def test_a_host_of_root_with_more_capabilities_gets_an_agent_that_may_read_its_files(place):
    with agent(place, DROPPED):
        assert host(place, DROPPED) == ""
        assert TURNED_AWAY in host(place)
    with agent(place):
        assert host(place, DROPPED) == ""


def test_a_host_without_a_filter_of_system_calls_gets_an_agent_without(place):
    with agent(place, FILTER):
        assert host(place, FILTER) == ""
        assert TURNED_AWAY in host(place)
    with agent(place):
        assert host(place, FILTER) == ""


@pytest.mark.parametrize("name", ["PQSEC_PKCS11_MODULE", "PQSEC_PIN_FILE"])
def test_a_host_with_another_library_of_tokens_gets_an_agent_that_loads_it(place, name):
    """Its token was not there, or its PIN was wrong, until the agent was stopped by hand."""
    with agent(place, **{name: "/one"}):
        assert host(place, **{name: "/one"}) == ""
        assert host(place) == ""  # it may have no token
        assert TURNED_AWAY in host(place, **{name: "/two"})


@contextmanager
def started(place, prelude=""):
    """A host that has started an agent, and has not connected to it."""
    if "setuid" in prelude:
        os.chown(place.folder, NOBODY, NOBODY)
    pipe = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(
        python(_STARTER, prelude, place), env=environment({}), text=True, **pipe
    )
    try:
        assert process.stdout.readline() == "listens\n"
        yield process
    finally:
        process.communicate()


def tell(starter, before=""):
    """What the host says when it has done `before` and connected."""
    print(before, file=starter.stdin, flush=True)
    return starter.stdout.readline()


@mounts
def test_the_host_that_started_the_agent_is_served_whatever_it_has(place):
    """Else it would start one agent after another."""
    with started(place) as starter:
        assert tell(starter, OTHER_MOUNTS) == "served\n"


@mounts
def test_all_connections_of_the_host_that_started_the_agent_are_served(place):
    with started(place) as starter:
        keep = "first = Client(AgentFolder(Path(sys.argv[2])), 'access_control')"
        assert tell(starter, keep) == tell(starter, OTHER_MOUNTS) == "served\n"


@mounts
def test_a_process_with_the_number_of_the_host_that_started_the_agent_is_not_that_host(place):
    with started(place) as starter:
        assert tell(starter) == "served\n"
        until(lambda: agent_status(place).connections == ())
        assert tell(starter, OTHER_MOUNTS) == ""


def test_a_host_that_connects_before_the_one_that_started_the_agent_has_none_of_its_rights(place):
    """The first to connect was served with the groups of the host that started the agent."""
    with started(place, as_nobody(groups=(100, 200))) as starter:
        other = subprocess.Popen(
            python(_HOST, as_nobody(groups=(100,)), place),
            env=environment({}),
            stderr=subprocess.PIPE,
            text=True,
        )
        until(lambda: len(connections(place)) == 2)
        assert tell(starter) == "served\n"
        assert TURNED_AWAY in other.communicate(timeout=PATIENCE)[1]


def test_a_host_that_connects_first_is_served_if_it_fits(place):
    with started(place) as starter:
        assert host(place) == ""  # the one that started the agent may be slow, or gone
        assert tell(starter) == "served\n"


def connections(place):
    """The sockets at that place: the agent's, and one of each process that is connected."""
    lines = Path("/proc/net/unix").read_text().splitlines()
    return [line for line in lines if line.endswith(f" {place.socket}")]


@mounts
def test_an_agent_that_was_not_started_by_a_host_serves_hosts_in_containers(place):
    """As `pqsec agent run` and systemd's do: who runs it has chosen what it sees and may."""
    code = (
        "import sys; from pathlib import Path; from datetime import UTC, datetime\n"
        "from pqsec_pki.plugin import AgentFolder; from pqsec_pki.plugin.server import Agent\n"
        "Agent(AgentFolder(Path(sys.argv[2])), 60, lambda: datetime.now(UTC), print).run()\n"
    )
    with subprocess.Popen(python(code, "", place), env=environment({}), stdout=-3) as process:
        try:
            until(lambda: agent_status(place))
            assert host(place) == host(place, OTHER_MOUNTS) == ""
        finally:
            process.kill()


@mounts
def test_hosts_of_the_agent_that_serves_no_others_stay(place):
    with agent(place) as process:
        first = Client(place, "authentication")
        assert TURNED_AWAY in host(place, OTHER_MOUNTS)
        assert process.poll() is None
        (found,) = retired_agents(place)
        assert found.notice.endswith("or root folder: it serves its present hosts only")
        first.close()
        assert process.wait(PATIENCE) == 0
        said = process.stderr.read()
    assert "a host has another mount name space or root folder: a new agent serves" in said
