"""Work shared out to processes, in a process of its own: one with threads is never forked."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from pqsec_pki._processes import LEAST
from pqsec_pki.algorithms import load_private_key, profile_named
from pqsec_pki.keystore import Keystore, audit, change
from tests.unit.killing import create

CORES = len(os.sched_getaffinity(0))
several = pytest.mark.skipif(CORES < 2, reason="one core: nothing is shared out")
BEGIN = """
import json, os, signal, sys, threading, time
from pqsec_pki._processes import shared_out
from pqsec_pki.errors import PqsecError, VerificationError
many = list(range(100))
"""


def run(script, *arguments):
    """What the script prints, as JSON."""
    command = [sys.executable, "-c", BEGIN + textwrap.dedent(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


@several
def test_every_core_takes_its_share_and_the_order_stays():
    done = run("print(json.dumps(shared_out(lambda a, b: (a + b, os.getpid()), many, many)))")
    assert [total for total, _ in done] == list(range(0, 200, 2))
    assert len({process for _, process in done}) == min(CORES, 100 // LEAST)


@pytest.mark.parametrize("count", [0, 1, 31])
def test_little_work_is_done_here(count):
    script = "print(json.dumps([os.getpid(), shared_out(lambda n: os.getpid(), many[:%d])]))"
    here, done = run(script % count)
    assert done == [here] * count


def test_a_process_with_threads_is_not_forked():
    script = """
        over = threading.Event()
        threading.Thread(target=over.wait).start()
        print(json.dumps([os.getpid(), shared_out(lambda n: os.getpid(), many)]))
        over.set()
    """
    here, done = run(script)
    assert set(done) == {here}


def test_where_no_process_can_be_started_the_work_is_done_here():
    script = """
        def fork():
            raise BlockingIOError("no more")
        os.fork = fork
        print(json.dumps([os.getpid(), shared_out(lambda n: os.getpid(), many)]))
    """
    here, done = run(script)
    assert set(done) == {here}


@pytest.mark.parametrize("first", range(20, 24))
def test_the_first_error_is_raised_with_all_that_it_tells(first):
    script = """
        first = int(sys.argv[1])
        def work(n):
            if n >= first:
                error = VerificationError(f"no {n}", "and no", hint="try another")
                error.where = "there"
                raise error
        try:
            shared_out(work, many)
        except VerificationError as error:
            print(json.dumps([*error.lines, error.hint]))
    """
    assert run(script, first) == [f"there: no {first}", "there: and no", "try another"]


def test_where_the_end_of_a_process_is_ignored_none_is_started():
    script = """
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        print(json.dumps([os.getpid(), shared_out(lambda n: os.getpid(), many)]))
    """
    here, done = run(script)
    assert set(done) == {here}


STRANGE = """
    class Picky(Exception):
        def __init__(self, first, second):
            super().__init__(f"{first} and {second}")
    def picky(n):
        raise Picky(n, n)
    def lock(n):
        return threading.Lock()
    here = os.getpid()
    def work(n):
        return %s(n) if os.getpid() != here else None
    try:
        shared_out(work, many)
    except RuntimeError as error:
        print(json.dumps(str(error)))
"""


@several
@pytest.mark.parametrize(
    ("what", "told"),
    [("picky", "Picky: 1 and 1"), ("lock", "TypeError: cannot pickle '_thread.lock' object")],
)
def test_what_cannot_travel_between_processes_is_told(what, told):
    assert run(STRANGE % what) == told


@several
def test_a_process_that_is_killed_is_told():
    script = """
        here = os.getpid()
        def work(n):
            if os.getpid() != here and n > 50:
                os.kill(os.getpid(), signal.SIGKILL)
        try:
            shared_out(work, many)
        except PqsecError as error:
            print(json.dumps([str(error), error.hint]))
    """
    assert run(script) == [
        "a worker process was killed",
        "if memory ran out, process fewer items at once",
    ]


SLOW = """
def work(n):
    with open(f"{sys.argv[1]}/{os.getpid()}", "a") as file:
        file.write("x")
    time.sleep(0.05)
shared_out(work, range(10_000))
"""


@pytest.mark.slow(but=1)
@several
@pytest.mark.parametrize(
    ("end", "code"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_the_others_end_with_the_first(tmp_path, end, code):
    """At once with Ctrl-C, and before their next item if it is killed."""
    command = [sys.executable, "-c", BEGIN + SLOW, tmp_path]
    first = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    processes = set()
    while len(processes) < 2:
        time.sleep(0.01)
        processes = {int(path.name) for path in tmp_path.iterdir()}
    os.kill(first.pid, end)
    assert first.wait(120) == code
    patience = time.monotonic() + 120
    while any(runs(each) for each in processes) and time.monotonic() < patience:
        time.sleep(0.01)
    assert [each for each in processes if runs(each)] == []


# A killed parent, with more workers than this machine has cores

EIGHT = """
from pathlib import Path
import pqsec_pki._processes as processes
from pqsec_pki.keystore import change
processes._cores = lambda: 8
here, place, k = os.getpid(), Path(sys.argv[1]), Path(sys.argv[2])
if sys.argv[3] == "alone":  # no help of the system
    processes.end_with = lambda parent: None
def work(n):
    if os.getpid() == here:
        (place / "parent").touch()
        time.sleep(600)
    %s
with change(k):
    shared_out(work, range(LEAST * 8))
""".replace("LEAST", str(LEAST))


@contextmanager
def eight_workers(tmp_path, what, help_of_system):
    """A parent that holds a keystore's lock and takes no answer, with its seven workers."""
    place, k = tmp_path / "place", tmp_path / "k"
    place.mkdir()
    create(k)
    command = [sys.executable, "-c", BEGIN + EIGHT % what, place, k, help_of_system]
    parent = subprocess.Popen(command)
    try:
        wait_until(lambda: len(children(parent.pid)) == 7 and (place / "parent").exists())
        workers = children(parent.pid)
        yield parent, workers, place, k
    finally:
        parent.kill()
        parent.wait()
        for each in filter(runs, workers):
            os.kill(each, signal.SIGKILL)


def children(process):
    return [
        int(each)
        for task in Path(f"/proc/{process}/task").iterdir()
        for each in (task / "children").read_text().split()
    ]


def wait_until(is_so):
    end = time.monotonic() + 120
    while not is_so() and time.monotonic() < end:
        time.sleep(0.01)
    assert is_so()


def is_free(keystore):
    handle = os.open(keystore, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(handle)
    return True


@pytest.mark.parametrize("help_of_system", ["ended", "alone"])
def test_workers_that_write_their_answers_end_with_a_killed_parent(tmp_path, help_of_system):
    """Their pipes are full: a reader in any of them would keep them all for ever."""
    made = "(place / str(n)).touch(); return bytes(1 << 20)"
    with eight_workers(tmp_path, made, help_of_system) as (parent, workers, place, k):
        wait_until(lambda: len(list(place.iterdir())) == LEAST * 7 + 1)
        wait_until(lambda: all(state(each) == "S" for each in workers))
        assert not is_free(k)
        parent.kill()
        parent.wait()
        wait_until(lambda: not any(map(runs, workers)))
        assert is_free(k)


def test_workers_in_the_middle_of_an_item_end_with_a_killed_parent(tmp_path):
    with eight_workers(tmp_path, "time.sleep(600)", "ended") as (parent, workers, _, k):
        parent.kill()
        parent.wait()
        wait_until(lambda: not any(map(runs, workers)))
        assert is_free(k)


def test_a_worker_that_cannot_end_holds_no_lock_of_its_killed_parent(tmp_path):
    """As one that waits for a disk."""
    with eight_workers(tmp_path, "time.sleep(600)", "alone") as (parent, workers, _, k):
        parent.kill()
        parent.wait()
        wait_until(lambda: is_free(k))
        assert all(map(runs, workers))
        assert Keystore.open(k, to_change=True).names() == []
        with change(k):  # removes the draft of the killed one
            assert len(list(k.glob(".draft-*"))) == 1


def test_a_worker_has_no_pipe_or_socket_of_its_parent(tmp_path):
    script = """
        import socket
        import pqsec_pki._processes as processes
        processes._cores = lambda: 8
        kept = os.pipe(), socket.socketpair()
        def work(n):
            handles = [each for each in os.listdir("/proc/self/fd") if int(each) > 2]
            names = [f"/proc/self/fd/{each}" for each in handles]
            found = [os.readlink(each) for each in names if os.path.lexists(each)]
            return os.getpid(), [each for each in found if each.startswith(("pipe:", "socket:"))]
        print(json.dumps([os.getpid(), shared_out(work, list(range(200)))]))
    """
    here, found = run(script)
    assert {len(links) for process, links in found if process != here} == {1}  # for its answer


def test_what_a_fork_still_adds_to_a_removed_draft_is_removed_too(tmp_path, monkeypatch):
    create(tmp_path)
    draft = tmp_path / ".draft-0123456789abcdef"
    (draft / "0").mkdir(parents=True)
    rmdir, left = os.rmdir, [3]

    def meanwhile(path, *, dir_fd=None):
        if left[0]:
            left[0] -= 1
            (draft / "0" / f"{left[0]}").touch()
        rmdir(path, dir_fd=dir_fd)

    monkeypatch.setattr(os, "rmdir", meanwhile)
    with change(tmp_path):
        pass
    assert (left, list(tmp_path.glob(".draft-*"))) == ([0], [])


def state(process):
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]


def runs(process):
    try:
        return state(process) != "Z"
    except OSError:
        return False


# What it is for

FLEET = """
from datetime import UTC, datetime, timedelta
from pathlib import Path
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew
now = datetime(2026, 11, 21, 12, tzinfo=UTC)
keystore = Keystore.open(Path(sys.argv[1]))
names = [f"/fleet/robot{n}" for n in range(50)]
domains, life = DomainSet.of(0), timedelta(days=9)
specs = [ParticipantSpec(name=n, domains=domains, validity=life) for n in names]
authorities = keystore.unlock(None)
processes = []
"""


@pytest.fixture
def fleet(tmp_path):
    create(tmp_path / "k")
    return tmp_path / "k"


@pytest.mark.slow
@several
def test_a_fleet_that_several_processes_made_is_whole(fleet):
    """No two keys or serial numbers are the same: a fork has random octets of its own."""
    script = """
        issue(keystore, authorities, specs, now=now)
        renew(keystore, authorities, names, now=now)
        print(json.dumps(None))
    """
    run(FLEET + textwrap.dedent(script), fleet)
    keystore = Keystore.open(fleet)
    audit(keystore)
    entries = [each for each in keystore.ledger() if each.kind == "participant"]
    assert len({each.serial for each in entries}) == 100
    folders = [fleet / "enclaves/fleet" / f"robot{n}" for n in range(50)]
    keys = [load_private_key((folder / "key.pem").read_bytes()) for folder in folders]
    assert len({key.public_key.spki for key in keys}) == 50
    assert {key.algorithm for key in keys} == {profile_named("transition").participant_key}


@pytest.mark.slow
@several
@pytest.mark.parametrize("wait", [0.05, 0.15])
def test_a_fleet_whose_maker_is_killed_can_be_made_by_the_next(fleet, wait):
    """Who comes next waits until the last of the killed one's processes has ended."""
    script = """
        print("ready", flush=True)
        issue(keystore, authorities, specs, now=now, force=True)
    """
    command = [sys.executable, "-c", BEGIN + FLEET + textwrap.dedent(script), fleet]
    first = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert first.stdout.readline() == "ready\n"
    time.sleep(wait)
    first.kill()
    first.wait()
    first.stdout.close()
    script = """
        issue(keystore, authorities, specs, now=now, force=True)
        print(json.dumps(len(keystore.names())))
    """
    assert run(FLEET + textwrap.dedent(script), fleet) == 50
    audit(Keystore.open(fleet))
    assert list(fleet.glob(".draft-*")) == []
