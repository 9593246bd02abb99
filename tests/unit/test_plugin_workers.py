"""The agent's workers: which one serves a host, what comes first, and what stays true over all."""

import errno
import fcntl
import json
import os
import resource
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import RevocationList
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import FileError, MalformedError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew_list, revoke
from pqsec_pki.plugin import AgentFolder, agent_status, channel, stop_agent, worker
from pqsec_pki.plugin.__main__ import MAX_LOG
from pqsec_pki.plugin.authentication import NO_TOKEN
from pqsec_pki.plugin.calls import WORKING
from pqsec_pki.plugin.connection import Connection
from pqsec_pki.plugin.control import Client
from pqsec_pki.plugin.lists import MAX_CAS, NewestLists
from pqsec_pki.plugin.octets import MessageWriter
from pqsec_pki.plugin.shared_lists import ListStore, exchange_through
from pqsec_pki.plugin.worker import FAIR, AgentWorker
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import asked, greeting, new_guid, properties, with_room_for

PATIENCE = 120
# The agent as on a machine with two cores, whose workers do not stay for hosts that may come.
_RUNNER = (
    "import os, runpy\n"
    "os.sched_getaffinity = lambda _: {0, 1}\n"
    "from pqsec_pki.plugin import workers\n"
    "workers.IDLE_SECONDS, workers.SILENT_SECONDS = 0.1, float(os.getenv('SILENT', '5'))\n"
    "runpy.run_module('pqsec_pki.plugin', run_name='__main__', alter_sys=True)\n"
)
# A host: connects twice, as its two plugins do, and stays until its stdin ends.
_HOST = (
    "import socket, sys\n"
    "links = []\n"
    "for octets in map(bytes.fromhex, sys.argv[2:]):\n"
    "    links.append(socket.socket(socket.AF_UNIX))\n"
    "    links[-1].connect(sys.argv[1])\n"
    "    links[-1].sendall(octets)\n"
    "    print(links[-1].recv(5).hex(), flush=True)\n"
    "sys.stdin.read()\n"
)
GREETINGS = [greeting(each).hex() for each in ("authentication", "access_control")]


@pytest.fixture
def place():
    """A place of this test's own; a socket's path must be short."""
    folder = Path(tempfile.mkdtemp(prefix="pqsec-"))
    (folder / "pqsec").mkdir(mode=0o700)
    yield AgentFolder.of({"XDG_RUNTIME_DIR": str(folder)})
    shutil.rmtree(folder)


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


@pytest.fixture
def agent(place):
    """An agent on two cores."""
    process = subprocess.Popen(
        [sys.executable, "-c", _RUNNER, str(place.socket)], stderr=subprocess.PIPE, text=True
    )
    try:
        until(lambda: agent_status(place))
        yield process
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


@contextmanager
def host(place):
    """A process with both plugins, as the agent names it."""
    process = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _HOST, str(place.socket), *GREETINGS],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert [process.stdout.readline() for _ in GREETINGS] == ["0100000000\n"] * 2
        yield process
    finally:
        process.communicate()


def runs(process):
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def sockets(process):
    found = []
    for each in Path(f"/proc/{process}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed since it was listed
            found.append(str(each.readlink()))
    return len([each for each in found if each.startswith("socket:")])


def connections(place):
    return [(each["process"], each["plugin"]) for each in agent_status(place).connections]


@pytest.mark.usefixtures("agent")
def test_hosts_are_spread_over_a_worker_for_each_core_and_a_host_stays_in_one(place):
    assert agent_status(place).workers == ()  # there is nobody to serve
    with ExitStack() as hosts:
        four = [hosts.enter_context(host(place)) for _ in range(4)]
        workers = agent_status(place).workers
        assert len(workers) == 2
        # Two channels, and both plugins of two hosts each.
        assert [sockets(each) for each in workers] == [2 + 4, 2 + 4]
        named = {f"[{each.pid}]" for each in four}
        assert {name[name.index("[") :] for name, _ in connections(place)} == named
        assert len(connections(place)) == 8


def test_where_no_further_worker_can_be_started_hosts_share_the_one_there_is(place, agent):
    with host(place):
        opened = max(int(each.name) for each in Path(f"/proc/{agent.pid}/fd").iterdir())
        most = opened + 3  # its connection, and not both ends of a worker's channel too
        resource.prlimit(agent.pid, resource.RLIMIT_NOFILE, (most, most))
        with host(place):
            assert len(agent_status(place).workers) == 1
            assert len(connections(place)) == 4
    agent.terminate()
    assert "no further worker can be started: Too many open files" in agent.stderr.read()


def test_who_goes_without_a_greeting_is_forgotten(place, agent):
    with host(place):
        until(lambda: sockets(agent.pid) == 1 + 2)  # its own, and a worker's channel
        with socket.socket(socket.AF_UNIX) as link:
            link.connect(str(place.socket))
            until(lambda: sockets(agent.pid) == 1 + 2 + 1)
        until(lambda: sockets(agent.pid) == 1 + 2)


@pytest.mark.usefixtures("agent")
def test_the_agent_has_no_key_and_nothing_of_a_host_open(place):
    with host(place):
        agent = agent_status(place).process
        until(lambda: sockets(agent) == 1 + 2)  # the connection that asked for the status is closed
        assert sockets(agent) == 1 + 2


@pytest.mark.usefixtures("agent")
def test_workers_end_and_leave_no_process_when_their_hosts_have_gone(place):
    with host(place), host(place):
        workers = agent_status(place).workers
    until(lambda: not any(map(runs, workers)))
    until(lambda: agent_status(place).workers == ())
    with host(place):
        assert len(agent_status(place).workers) == 1


def test_a_worker_that_dies_takes_its_own_hosts_with_it_and_nobody_elses(place, agent):
    with host(place) as first, host(place):
        one, other = agent_status(place).workers
        os.kill(one, signal.SIGKILL)
        until(lambda: agent_status(place).workers == (other,))
        assert len(connections(place)) == 2
        assert str(first.pid) not in str(connections(place))
        with host(place):
            assert len(agent_status(place).workers) == 2
    agent.terminate()
    assert f"worker {one} ended with -9: 2 connections lost" in agent.stderr.read()


def test_no_worker_outlives_an_agent_that_is_killed_or_stopped(place, agent):
    with host(place), host(place):
        workers = agent_status(place).workers
        agent.kill()
        until(lambda: not any(map(runs, workers)))
    with subprocess.Popen(
        [sys.executable, "-c", _RUNNER, str(place.socket)], stderr=subprocess.DEVNULL
    ) as second:
        until(lambda: agent_status(place))
        with host(place), host(place):
            workers = agent_status(place).workers
            assert stop_agent(place)
            assert not any(map(runs, workers))
        assert second.wait(PATIENCE) == 0


@pytest.mark.usefixtures("agent")
def test_the_status_is_told_though_a_worker_hangs_and_other_hosts_are_served(place):
    with host(place):
        (hangs,) = agent_status(place).workers
        os.kill(hangs, signal.SIGSTOP)
        try:
            with host(place):
                assert len(connections(place)) == 4
        finally:
            os.kill(hangs, signal.SIGCONT)


@pytest.fixture
def impatient(monkeypatch):
    """Agents that take a worker for one that hangs after half a second."""
    monkeypatch.setenv("SILENT", "0.5")


@pytest.mark.usefixtures("impatient", "agent")
def test_a_worker_that_hangs_gets_no_further_hosts_and_goes_on_when_it_can(place):
    """It kept a core's share of all hosts that came, and each waited in vain."""
    nobody = (0, [0])
    with ExitStack() as clients:

        def client():
            return clients.enter_context(closing(Client(place, "authentication")))

        first = client()
        until(lambda: first.call("find_revoked") == nobody)
        (hangs,) = agent_status(place).workers
        os.kill(hangs, signal.SIGSTOP)
        try:
            unlucky = client()  # nobody knows yet
            time.sleep(1)
            assert client().call("find_revoked") == nobody
        finally:
            os.kill(hangs, signal.SIGCONT)
        for each in (first, unlucky):
            assert each.call("find_revoked") == nobody


@pytest.mark.usefixtures("agent")
def test_the_status_counts_the_objects_that_workers_have(place, tmp_path):
    domains, now = DomainSet.parse("0"), datetime.now(UTC)  # as the agent's clock
    profile = profile_named("classical")
    options = {"domains": domains, "validity": DAY, "passphrase": None, "now": now}
    store = Keystore.create(tmp_path / "k", profile, name="Test", **options)
    spec = ParticipantSpec(name="/talker", domains=domains, validity=DAY)
    issue(store, store.unlock(None), [spec], now=now)
    client = Client(place, "authentication")
    pairs, where = properties(store.root / "enclaves/talker")
    for count in range(3):
        (found,) = agent_status(place).connections
        assert found["objects"] == count
        client.call("validate_local_identity", 0, where, pairs, new_guid())
    client.close()


def test_a_full_agent_can_still_be_asked_and_stopped(place):
    """It was refused like a host."""
    command = [*with_room_for(4), sys.executable, "-c", _RUNNER]
    with subprocess.Popen(
        [*command, str(place.socket), "300"], stderr=subprocess.DEVNULL
    ) as process:
        until(lambda: agent_status(place))
        with host(place), host(place):
            with pytest.raises(MalformedError, match="the agent is full: 4 connections"):
                Client(place, "authentication")
            assert len(connections(place)) == 4
            assert stop_agent(place)
        assert process.wait(PATIENCE) == 0


# What is shared: revocation lists.


@pytest.fixture(scope="module")
def three_lists(tmp_path_factory):
    """A CA, and its lists number 1 to 3."""
    store = made(tmp_path_factory.mktemp("k") / "k", "classical")
    revoke(store, store.unlock(None), ["/talker"], now=NOW)
    found = [RevocationList.from_pem((store.root / "enclaves/listener/crl.pem").read_bytes())]
    for _ in range(2):
        renew_list(store, store.unlock(None), now=NOW)
        found.append(
            RevocationList.from_pem((store.root / "enclaves/listener/crl.pem").read_bytes())
        )
    assert [each.number for each in found] == sorted({each.number for each in found})
    return store.unlock(None).identity.certificate, found


@pytest.fixture
def two_workers():
    """The lists of two workers, and the agent's store between them."""
    store, ends = ListStore(), [channel.pair() for _ in range(2)]
    stop, stopped = socket.socketpair()

    def serve():
        while True:
            ready, *_ = select.select([stopped, *(each[0] for each in ends)], [], [])
            if stopped in ready:
                return
            for each in ready:
                store.answer(each, *channel.take(each))

    thread = threading.Thread(target=serve)
    thread.start()
    yield [NewestLists(exchange_through(each[1])) for each in ends], store
    stop.close()
    thread.join()
    store.close()
    for each in (stopped, *ends[0], *ends[1]):
        each.close()


def test_the_numbers_of_lists_only_grow_across_workers(two_workers, three_lists):
    ca, (old, newer, newest) = three_lists
    (one, other), _ = two_workers

    def counts(worker_lists, found):
        return worker_lists.newest(ca, found, alternative=False, now=NOW).number

    assert counts(one, newer) == newer.number
    assert counts(other, old) == newer.number  # which this worker has not seen
    assert counts(other, newest) == newest.number
    assert counts(one, newer) == newest.number
    assert counts(one, old) == newest.number


def test_lists_are_shared_between_equal_demands_only_and_the_latest_cas(two_workers, three_lists):
    ca, (old, newer, _) = three_lists
    (one, other), store = two_workers
    one.newest(ca, newer, alternative=True, now=NOW)
    assert other.newest(ca, old, alternative=False, now=NOW) is old
    before = len(list(Path("/proc/self/fd").iterdir()))
    for number in range(2 * MAX_CAS):
        issuer = b"%d" % number, b"", b"", False
        one.exchange(issuer, newer)
    assert len(store._newest) == MAX_CAS
    assert len(list(Path("/proc/self/fd").iterdir())) <= before + MAX_CAS
    assert other.exchange(issuer, None).number == newer.number


def test_the_agent_keeps_one_file_of_a_ca_and_closes_the_older_one(three_lists):
    """Each worker shows a list that is newer than the one it knows, and two may do so at once."""
    store, (ours, theirs) = ListStore(), channel.pair()
    before = len(list(Path("/proc/self/fd").iterdir()))
    with ours, theirs:
        for number in (2, 3, 2):  # the first one, one that is newer, and one that is older
            question = MessageWriter()
            question.raw(bytes(32))
            question.raw(number.to_bytes(32, "little"))
            file = os.memfd_create("list")
            channel.put(theirs, question, file)
            os.close(file)
            store.answer(ours, *channel.take(ours))
            assert len(list(Path("/proc/self/fd").iterdir())) == before + 1
        store.close()
        assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_worker_whose_agent_has_ended_takes_no_list(three_lists):
    ours, theirs = channel.pair()
    ours.close()
    ca, (old, *_) = three_lists
    with theirs, pytest.raises(FileError, match="the agent has ended"):
        NewestLists(exchange_through(theirs)).newest(ca, old, alternative=False, now=NOW)


def test_a_list_whose_file_got_lost_on_the_way_does_not_leave_the_older_one_in_force(three_lists):
    """The kernel drops the file of a process that has too many open; the answer said "newer"."""
    ours, theirs = channel.pair()
    ca, (old, *_) = three_lists
    with ours, theirs:
        channel.put(ours, channel.message("newer"))
        with pytest.raises(FileError, match="a revocation list got lost"):
            NewestLists(exchange_through(theirs)).newest(ca, old, alternative=False, now=NOW)


def test_a_shown_list_whose_file_got_lost_is_an_error(three_lists):
    ours, theirs = channel.pair()
    ca, (old, *_) = three_lists
    with ours, theirs:
        channel.put(ours, channel.message("show"))
        channel.put(ours, channel.message("show"))
        with pytest.raises(FileError, match="a revocation list got lost"):
            NewestLists(exchange_through(theirs)).newest(ca, old, alternative=False, now=NOW)


def test_a_worker_that_cannot_be_answered_does_not_wait_for_ever(monkeypatch, three_lists):
    ours, theirs = channel.pair()
    ca, (old, *_) = three_lists
    store = ListStore()
    found = []

    def ask():
        with pytest.raises(FileError, match="the agent has ended") as caught:
            NewestLists(exchange_through(theirs)).newest(ca, old, alternative=False, now=NOW)
        found.append(caught.value)

    asking = threading.Thread(target=ask)
    with ours, theirs:
        asking.start()
        question = channel.take(ours)

        def full(*_):
            raise OSError(errno.ETOOMANYREFS, "too many references")

        monkeypatch.setattr(channel, "put", full)
        store.answer(ours, *question)
        asking.join(PATIENCE)
    assert len(found) == 1


def test_an_agent_whose_parent_ignores_the_end_of_children_outlives_its_workers(place):
    """Then the system reaps workers itself, and waiting for one ended the agent."""
    process = subprocess.Popen(
        [sys.executable, "-c", _RUNNER, str(place.socket)],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGCHLD, signal.SIG_IGN),  # noqa: PLW1509
    )
    try:
        until(lambda: agent_status(place))
        with host(place):
            assert len(agent_status(place).workers) == 1
        until(lambda: agent_status(place).workers == ())
        assert agent_status(place).process == process.pid
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def test_nobody_waits_for_a_process_that_holds_the_log(place):
    """Any process of the user can lock it."""
    log = place.socket.with_name("agent.log")
    with log.open("ab") as stderr, log.open("r+b") as held:
        fcntl.lockf(held, fcntl.LOCK_EX)
        stderr.write(b"x" * (MAX_LOG + 1) + b"\n")
        stderr.flush()
        process = subprocess.Popen(
            [sys.executable, "-c", _RUNNER, str(place.socket)], stderr=stderr
        )
        try:
            until(lambda: agent_status(place))  # which is after its first line in the log
            with host(place):
                assert len(agent_status(place).workers) == 1
            assert b"listening at" in log.read_bytes()[MAX_LOG:]
        finally:
            process.kill()
            process.wait()


# What comes first in a worker.


@contextmanager
def served(plugins, frames):
    """A worker in this process, to which each connection has said its frame before it begins."""
    (orders, theirs), (lists, others) = channel.pair(), channel.pair()
    links = []
    for number, (plugin, octets) in enumerate(zip(plugins, frames, strict=True)):
        mine, its = socket.socketpair()
        mine.settimeout(PATIENCE)
        mine.sendall(octets)
        order = channel.message(channel.SERVE)
        order.number("I", number)
        order.text(plugin)
        order.text(f"host[{number}]")
        channel.put(orders, order, its.fileno())
        its.close()
        links.append(mine)
    subject = AgentWorker(theirs, others, lambda: NOW, lambda _: None)
    while orders_wait(theirs):
        subject._read_order(0)
    for client in subject._clients.values():
        subject._attend(client, select_read())
    thread = threading.Thread(target=subject.run)
    try:
        yield subject, links, thread
    finally:
        orders.close()
        thread.join()
        for each in (theirs, lists, others, *links):
            each.close()


def orders_wait(link):
    return bool(select.select([link], [], [], 0)[0])


def select_read():
    return worker.selectors.EVENT_READ


def frame_of(link):
    size = int.from_bytes(link.recv(4, socket.MSG_WAITALL), "little")
    return link.recv(size, socket.MSG_WAITALL) if size else b""


@pytest.fixture
def order(monkeypatch):
    """The names of the connections in the order in which they are answered."""
    found, plain = [], Connection.answer

    def answer(self):
        found.append(self.what[0])
        return plain(self)

    monkeypatch.setattr(Connection, "answer", answer)
    return found


def process():
    return asked("authentication", "process_handshake", NO_TOKEN, 1)


def create():
    return asked("authentication", "validate_local_identity", 0, "/", (), new_guid())


def test_a_participant_is_created_before_handshakes_that_came_earlier(order):
    """40 hosts that shook hands kept the 41st waiting for seconds."""
    frames = [process(), process(), create()]
    with served(["authentication"] * 3, frames) as (_, links, thread):
        thread.start()
        assert all(frame_of(link)[:1] == b"\1" for link in links)  # refused, all of them
    assert order == ["host[2]", "host[0]", "host[1]"]


def test_nobody_keeps_handshakes_waiting_for_ever(order):
    frames = [process(), *(create() for _ in range(2 * FAIR))]
    with served(["authentication"] * len(frames), frames) as (_, links, thread):
        thread.start()
        for link in links:
            frame_of(link)
    assert order.index("host[0]") == FAIR


def test_a_call_that_comes_in_parts_is_answered_when_it_is_whole():
    whole = create()
    for cut in (1, 4, len(whole) - 1):
        with served(["authentication"], [whole[:cut]]) as (_, (link,), thread):
            thread.start()
            link.sendall(whole[cut:])
            assert frame_of(link)[:1] == b"\1"


def test_who_waits_for_its_turn_is_told_that_the_agent_works(monkeypatch):
    monkeypatch.setattr(worker, "TELL_SECONDS", 0.0)
    with served(["authentication"] * 2, [create()] * 2) as (_, (first, second), thread):
        thread.start()
        assert frame_of(first)[:1] == b"\1"
        head = second.recv(len(WORKING), socket.MSG_WAITALL)
        assert head == WORKING
        while not (answer := frame_of(second)):
            pass
    assert answer[:1] == b"\1"


def test_the_command_line_shows_the_workers(place, agent):
    environment = os.environ | {"XDG_RUNTIME_DIR": str(place.folder.parent)}

    def said(*words):
        command = [sys.executable, "-m", "pqsec_pki", "agent", "status", *words]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout

    assert "workers   none: no host is connected\n" in said()
    with host(place), host(place):
        found = json.loads(said("--json"))
        one, other = found["workers"]
        assert (found["process"], (one, other)) == (agent.pid, agent_status(place).workers)
        assert f"workers   {one} {other}\n" in said()
