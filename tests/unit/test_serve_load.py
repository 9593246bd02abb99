"""The server among thousands of clients that only take room: memory has a bound, robots are served.

In `.ci/long` with 10,000 connections, or as many as this machine lets a process have.
"""

import hashlib
import resource
import signal
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from socket import socket

import pytest
from OpenSSL import SSL

from pqsec_pki.keystore import Entry, change
from pqsec_pki.keystore.layout import LEDGER
from pqsec_pki.server.asking import MOST_OPEN
from pqsec_pki.server.configuration import ServerLimits
from pqsec_pki.server.limiting import Shares
from tests.longer import LONG
from tests.unit.serving import HOST, Robot, Server, basic, received, reply_in
from tests.unit.test_serve_hostile import counted, until

MIB = 1 << 20
DAY = timedelta(days=1)
OF_ADDRESS = 50
HALF_OPEN, SLOW, READERS = (10_000, 600, 60) if LONG else (1000, 40, 20)
ROOM = 2000 if LONG else 100
BUFFERED = (32 if LONG else 2) * MIB
RECEIPT = b"POST /pqsec/v1/receipts HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000\r\n\r\n"
LIMITS = {"connections": ROOM, "connections_of_address": OF_ADDRESS, "buffered": BUFFERED}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    limits = LIMITS | {"requests_of_address": 10_000, "seconds": 60 if LONG else 15}
    made = Server(tmp_path_factory.mktemp("serve"), datetime.now(UTC), limits=limits)
    with made.running():
        assert Robot(made, made.folder / "first").name  # keys are made before memory is measured
        assert made.send("GET", "/pqsec/v1/head").status == 200
        yield made


def most_memory(server):
    """The most that the process that faces the network ever had in memory, in octets."""
    pid = server.process.pid
    [front] = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    lines = Path(f"/proc/{front}/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


def address_of(number):
    """Where connection `number` comes from: as many from one address as the server allows."""
    network, host = divmod(number // OF_ADDRESS, 250)
    return f"127.1.{network}.{host + 1}"


@contextmanager
def half_open(server, count):
    """So many connections that send nothing; those that the server closes stay at this end."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    with ExitStack() as stack:
        for number in range(min(count, hard - 500)):
            link = stack.enter_context(socket())
            link.bind((address_of(number), 0))
            link.connect((HOST, server.port))
        yield


def is_served(server, name, folder):
    made = Robot(server, folder, name)
    return server.ask(made.request, token=server.token(name)).status == 200


def test_half_open_connections_take_little_memory_and_nobodys_place(server, tmp_path):
    before, closed = most_memory(server), counted(server, "closed-for-others")
    with half_open(server, HALF_OPEN):
        until(lambda: counted(server, "closed-for-others") >= closed + HALF_OPEN - ROOM - 5)
        assert is_served(server, "/fleet/r1", tmp_path)
    assert most_memory(server) - before < ROOM * (100 << 10) + 8 * MIB


def test_bodies_that_never_end_take_a_bounded_amount_of_memory(server, tmp_path):
    before = most_memory(server)
    robot, token = Robot(server, tmp_path, "/fleet/r2"), server.token("/fleet/r2")
    lines = ["POST /pqsec/v1/requests HTTP/1.1", "Host: x", "Connection: close"]
    lines += ["Content-Type: application/x-pem-file", f"Authorization: {basic(token)}"]
    lines.append(f"Content-Length: {len(robot.request.pem)}")
    with ExitStack() as stack:
        honest = stack.enter_context(server.connect(source="127.0.0.9"))
        honest.sendall("\r\n".join([*lines, "", ""]).encode() + robot.request.pem[:4000])
        for number in range(SLOW):
            link = stack.enter_context(server.connect(source=address_of(number)))
            with suppress(SSL.Error, OSError):
                link.sendall(RECEIPT + bytes(999_999))
        until(lambda: counted(server, "refused-503") >= SLOW - BUFFERED // 999_999 - 1)
        honest.sendall(robot.request.pem[4000:])
        assert reply_in(received(honest)).status == 200
    assert most_memory(server) - before < BUFFERED + SLOW * (100 << 10) + 8 * MIB


def test_who_is_refused_for_others_is_told_when_to_come_again(server):
    with server.connect(source=address_of(0)) as link:
        others = [server.connect(source=address_of(0)) for _ in range(BUFFERED // 900_000)]
        with ExitStack() as stack:
            link.sendall(RECEIPT + bytes(900_000))
            for each in others:
                stack.enter_context(each).sendall(RECEIPT + bytes(900_000))
            reply = reply_in(received(link))
    assert (reply.status, reply.headers["retry-after"]) == (503, "10")


def test_of_what_waits_for_the_signer_each_address_has_its_turn():
    waiting = Shares()
    for each in ("a1", "a2", "a3", "b1", "c1", "b2"):
        waiting.add(each[0], each)
    told = [waiting.in_turn() for _ in range(4)]
    waiting.add("c", "c2")
    told += [waiting.in_turn() for _ in range(4)]
    assert told == ["a1", "b1", "c1", "a2", "b2", "a3", "c2", None]


RECEIPT_SIZE = 16 * ServerLimits().body
MANY = {
    "small": (b"GET /pqsec/v1/bundle HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n", MOST_OPEN),
    "large": (
        b"POST /pqsec/v1/receipts HTTP/1.1\r\nHost: x\r\nConnection: close\r\n"
        b"Content-Type: application/vnd.pqsec.receipt\r\n"
        b"Content-Length: %d\r\n\r\n" % RECEIPT_SIZE + bytes(RECEIPT_SIZE),
        16,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("size", MANY)
def test_strangers_with_many_requests_keep_no_robot_from_the_signer(tmp_path, size):
    """All that the signer could take was theirs, and until they had answers robots got 503."""
    ask, count = MANY[size]
    limits = {"connections_of_address": 300, "requests_of_address": 10_000}
    server = Server(tmp_path, datetime.now(UTC), "classical", limits=limits)
    robot, token, stranger = Robot(server, tmp_path / "r"), server.token("/fleet/r1"), "127.0.0.66"
    with server.running(), ExitStack() as stack, ThreadPoolExecutor(1) as pool:
        server.process.send_signal(signal.SIGSTOP)
        links = [stack.enter_context(server.connect(source=stranger)) for _ in range(count)]
        for each in links:
            each.sendall(ask)
        waiting = f"pqsec_serve_waiting_calls {count}\n"
        until(lambda: waiting in server.page("/metrics", text=True))
        asked = pool.submit(server.ask, robot.request, token=token)
        until(lambda: asked.done() or counted(server, "status-503"))
        server.process.send_signal(signal.SIGCONT)
        assert asked.result().status == 200
        told = Counter(reply_in(received(each)).status for each in links)
        assert told == {401: count - 1, 503: 1}


def test_an_answer_that_nobody_reads_is_not_in_memory_once_for_each(server):
    """The revocation list stands for whatever is large: the front sends what the signer gives."""
    data = bytes(range(256)) * (4 * MIB // 256)
    path, ledger = server.keystore.revocation_list_path, server.keystore.root / "private" / LEDGER
    before_it = ledger.read_bytes()
    path.write_bytes(data)
    with change(server.keystore.root) as transaction:  # the server gives what the ledger has
        issuer, now = server.keystore.identity_ca.fingerprint, datetime.now(UTC)
        sha256 = hashlib.sha256(data).hexdigest()
        transaction.record(Entry.of("crl", "", sha256, now, not_after=now + DAY, issuer=issuer))
    ask = b"GET /pqsec/v1/revocation-lists HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
    try:
        assert server.send("GET", "/pqsec/v1/revocation-lists").body == data
        before = most_memory(server)
        with ExitStack() as stack:
            links = [
                stack.enter_context(server.connect(source=address_of(number)))
                for number in range(READERS)
            ]
            for link in links:
                link.sendall(ask)
            time.sleep(1)
            grown = most_memory(server) - before
            assert reply_in(received(links[0])).body == data
    finally:
        path.unlink()
        ledger.write_bytes(before_it)
    assert grown < READERS * (200 << 10) + 40 * MIB  # what several asked at once came several times
