"""The status address has the limits of the other one: neighbours on the machine do not stop it."""

import http.client
import socket
from contextlib import ExitStack, suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.server.configuration import ServerLimits
from tests.unit.serving import HOST, PATIENCE, Robot, Server
from tests.unit.test_serve_hostile import counted, until

ENEMY = "127.0.0.66"
MIB = 1 << 20
LIMITS = {"seconds": 2, "body": 20_000, "connections": 60, "connections_of_address": 20}
REQUESTS = ServerLimits().of_status.requests_of_address


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    made = Server(tmp_path_factory.mktemp("serve"), datetime.now(UTC), limits=LIMITS)
    with made.running():
        yield made


@pytest.fixture
def links():
    with ExitStack() as stack:
        yield stack


def front_of(server):
    """The process that faces the network."""
    pid = server.process.pid
    [front] = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return Path("/proc", front)


def opened(server, links, *, source=ENEMY):
    """A connection of another program of the machine to the status address."""
    link = links.enter_context(socket.socket())
    link.settimeout(PATIENCE)
    link.bind((source, 0))
    link.connect((HOST, server.status_port))
    return link


def answer(link, data):
    """What is answered until the server closes."""
    found = b""
    with suppress(ConnectionError):
        link.sendall(data)
    with suppress(ConnectionError):
        while piece := link.recv(1 << 16):
            found += piece
    return found


def test_idle_connections_at_the_status_address_are_few_and_end(server, links, tmp_path):
    """They took every descriptor of the process, and robots could no longer enrol."""
    before = len(list((front_of(server) / "fd").iterdir()))
    for number in range(400):
        opened(server, links, source=f"127.1.0.{number % 40 + 1}")
    until(lambda: counted(server, "status-address-closed-for-others") >= 400 - 60 - 5)
    assert len(list((front_of(server) / "fd").iterdir())) < before + 60 + 10
    robot = Robot(server, tmp_path, "/fleet/r1")
    assert server.ask(robot.request, token=server.token("/fleet/r1")).status == 200
    until(lambda: counted(server, "status-address-late") >= 1)  # and those that are left end


def test_an_address_has_a_limited_number_of_connections(server, links):
    before = counted(server, "status-address-too-many")
    for _ in range(30):
        opened(server, links)
    until(lambda: counted(server, "status-address-too-many") >= before + 10)
    assert server.page("/healthz") == 200


def test_a_body_is_not_kept(server, links):
    """One of 292 MB was."""
    front = front_of(server)

    def most():
        lines = (front / "status").read_text().splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))

    before = most()
    head = b"POST /metrics HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n"
    reply = answer(opened(server, links), head % (32 * MIB) + bytes(32 * MIB))
    assert reply.startswith(b"HTTP/1.1 413 ") or not reply
    chunked = b"POST /metrics HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
    piece = b"100000\r\n" + bytes(MIB) + b"\r\n"
    reply = answer(opened(server, links), chunked + 8 * piece)
    assert reply.startswith(b"HTTP/1.1 411 ") or not reply
    assert most() - before < 8 * MIB


@pytest.mark.parametrize(
    "lines", [b"X-Line: " + bytes(20_000).replace(b"\0", b"x"), b"X-Line: x\r\n" * 200]
)
def test_a_header_has_the_limits_of_the_other_address(server, links, lines):
    asked = b"GET /healthz HTTP/1.1\r\nHost: x\r\n" + lines.strip() + b"\r\n\r\n"
    assert b"200 OK" not in answer(opened(server, links), asked)


def test_a_request_that_is_never_complete_ends(server, links):
    link = opened(server, links)
    assert answer(link, b"GET /healthz HTTP/1.1\r\n") == b""


def test_an_address_asks_a_limited_number_of_times(server):
    links = [
        http.client.HTTPConnection(HOST, server.status_port, PATIENCE, ("127.0.0.77", 0))
        for _ in range(16)
    ]  # one after another, requests of a busy machine may be as slow as what is allowed again
    found = []
    with suppress(ConnectionError, http.client.HTTPException):
        while len(found) < 6 * REQUESTS and (not found or found[-1][0] == 200):
            for link in links:
                link.request("GET", "/healthz")
            replies = [link.getresponse() for link in links]
            found += sorted((reply.status, reply.read()) for reply in replies)
    for link in links:
        link.close()
    assert found[0] == (200, b"ok\n")
    assert found[-1] == (429, b"too many requests: ask later\n")
    assert len(found) > REQUESTS
    assert server.page("/healthz") == 200  # others are not affected


def test_a_neighbour_at_the_status_address_takes_no_place_of_a_robot(server, links):
    for number in range(80):
        opened(server, links, source=f"127.1.1.{number % 8 + 1}")
    assert server.send("GET", "/pqsec/v1/head").status == 200
    assert (server.page("/healthz"), server.page("/readyz"), server.page("/x")) == (200, 200, 404)
    assert "pqsec_serve_connections 0\n" in server.page("/metrics", text=True)


def test_few_requests_of_robots_do_not_stop_the_checks_of_the_machine():
    few, many = ServerLimits(requests_of_address=5), ServerLimits(requests_of_address=1000)
    assert few.of_status.requests_of_address == ServerLimits().of_status.requests_of_address
    assert many.of_status == replace(many, requests_of_address=10_000)
