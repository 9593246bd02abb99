"""Requests that are made to get past a check: nothing is issued, and honest robots are served."""

import base64
import socket
import threading
import time
from contextlib import ExitStack, suppress
from datetime import UTC, datetime

import pytest
from OpenSSL import SSL

from pqsec_pki.enrolment import Bundle
from pqsec_pki.est import TlsIdentity
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import revoke
from tests.unit.serving import HOST, PATIENCE, Robot, Server, basic, received, reply_in
from tests.unit.test_serve_hostile import ENEMY, counted, until
from tests.unit.tls_sides import certificate

EST = "/.well-known/est"
LIMITS = {"seconds": 6, "connections_of_address": 30, "requests_of_address": 1000}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("serve")
    made = Server(folder, datetime.now(UTC), limits=LIMITS, renew="any-time")
    with made.running():
        yield made


@pytest.fixture(scope="module")
def offer(server):
    """A request that a plain path would answer, as long as nothing was issued for it."""
    return Robot(server, server.folder / "offer"), server.token("/fleet/*", uses=100)


def issued(server):
    return [each for each in server.keystore.ledger() if each.kind == "participant"]


def sent(server, first, offer, *, more=()):
    """The answer to the offer with this first line."""
    robot, token = offer
    body = base64.b64encode(robot.request.der)
    lines = [first, f"Host: {HOST}", "Connection: close", f"Authorization: {basic(token)}"]
    lines += ["Content-Type: application/pkcs10", f"Content-Length: {len(body)}", *more]
    with server.connect(source=ENEMY) as link:
        link.sendall("\r\n".join([*lines, "", ""]).encode("latin-1") + body)
        return received(link)


TARGETS = {
    f"{EST}/fleet%2Fsimpleenroll": 404,
    f"{EST}%2ffleet/simpleenroll": 404,
    f"{EST}/%66leet/simpleenroll": 404,
    f"{EST}/fleet%00/simpleenroll": 404,
    f"{EST}/./simpleenroll": 404,
    f"{EST}/../est/simpleenroll": 404,
    f"{EST}/other/../simpleenroll": 404,
    f"{EST}/%2e%2e/est/simpleenroll": 404,
    f"{EST}/simpleenroll/": 404,
    f"{EST}/simpleenroll/.": 404,
    f"{EST}/fleet//simpleenroll": 404,
    f"{EST}//simpleenroll": 404,
    f"/{EST}/simpleenroll": 404,
    f"{EST}/simpleenroll?": 404,
    f"{EST}/simpleenroll;x": 404,
    f"{EST}/simpleenroll#x": 404,
    f"{EST}\\simpleenroll": 404,
    f"{EST}/SimpleEnroll": 404,
    f"{EST.upper()}/simpleenroll": 404,
    f"{EST}/fleet/fleet/simpleenroll": 404,
    f"{EST}/simpleenroll/simpleenroll": 404,
    f"{EST}/Fleet/simpleenroll": 404,  # labels that no group has
    f"{EST}/nowhere/simpleenroll": 404,
    f"{EST}/@fleet/simpleenroll": 404,
    f"{EST}/*/simpleenroll": 404,
    f"{EST}/fl\xe9et/simpleenroll": 400,
    f"{EST}/other/simpleenroll": 403,  # a group that the robot is not in
    f"https://{HOST}{EST}/simpleenroll": 404,
    f"http://elsewhere.example{EST}/simpleenroll": 404,
    f"{HOST}:8443": 404,
    "*": 404,
    f"{EST}/{'a' * 12_000}/simpleenroll": 404,
}


@pytest.mark.parametrize("target", TARGETS, ids=lambda each: ascii(each)[1:60])
def test_another_spelling_of_a_path_is_another_path(server, offer, target):
    before = server.keystore.head
    reply = reply_in(sent(server, f"POST {target} HTTP/1.1", offer))
    assert reply.status == TARGETS[target]
    assert server.keystore.head == before


FIRST_LINES = {
    f"CONNECT {HOST}:8443 HTTP/1.1": 404,
    f"CONNECT {EST}/simpleenroll HTTP/1.1": 405,
    f"PUT {EST}/simpleenroll HTTP/1.1": 405,
    f"post {EST}/simpleenroll HTTP/1.1": 405,
    f"GET {EST}/simpleenroll HTTP/1.1": 405,
    f"OPTIONS {EST}/simpleenroll HTTP/1.1": 405,
    f"POST {EST}/simpleenroll": 400,
    f"POST  {EST}/simpleenroll HTTP/1.1": 400,
    f"POST {EST}/simpleenroll x HTTP/1.1": 400,
    f"POST {EST}/simple enroll HTTP/1.1": 400,
    f"POST {EST}/simpleenroll HTTP/2.0": 400,
    f"POST {EST}/simpleenroll FTP/1.1": 400,
}


@pytest.mark.parametrize("first", FIRST_LINES)
def test_another_method_or_first_line_is_refused(server, offer, first):
    before = server.keystore.head
    assert reply_in(sent(server, first, offer)).status == FIRST_LINES[first]
    assert server.keystore.head == before


@pytest.mark.parametrize(
    "line", ["X-HTTP-Method-Override: POST", f"X-Original-URL: {EST}/simpleenroll"]
)
def test_no_header_line_says_another_method_or_path(server, offer, line):
    first = f"GET {EST}/cacerts HTTP/1.1"
    assert reply_in(sent(server, first, offer, more=[line])).body.startswith(b"MI")
    assert reply_in(sent(server, "POST / HTTP/1.1", offer, more=[line])).status == 404


OVERSIZED = {
    "a target": ([], f"POST /{'a' * 20_000} HTTP/1.1"),
    "a name": (["X" * 17_000 + ": 1"], None),
    "a credential": (["Authorization: Basic " + "A" * 14_000], None),
    "many lines": ([f"X-{each}: 1" for each in range(70)], None),
}


@pytest.mark.parametrize("what", OVERSIZED)
def test_what_is_too_large_is_refused(server, offer, what):
    more, first = OVERSIZED[what]
    before, late = server.keystore.head, counted(server, "late")
    found = b""
    with suppress(SSL.Error, OSError):
        found = sent(server, first or f"POST {EST}/simpleenroll HTTP/1.1", offer, more=more)
    assert not found or reply_in(found).status == 400
    assert counted(server, "late") == late  # nobody waited
    assert server.keystore.head == before


def test_a_client_certificate_without_end_is_refused_in_the_handshake(server):
    chain, key = certificate("ml-dsa-65", since=datetime.now(UTC))
    shown = TlsIdentity(chain * 60, key)
    with pytest.raises((SSL.Error, OSError, IndexError)):  # no answer at all
        server.send("GET", "/pqsec/v1/bundle", identity=shown)


def test_a_handshake_that_comes_octet_by_octet_is_cut_off(server):
    before = counted(server, "late")
    hello = bytes.fromhex("16030106000100")  # a record of a long ClientHello begins
    with ExitStack() as stack:
        links = [stack.enter_context(socket.socket()) for _ in range(10)]
        for link in links:
            link.bind((ENEMY, 0))
            link.connect((HOST, server.port))
        end = time.monotonic() + PATIENCE
        while counted(server, "late") < before + len(links) and time.monotonic() < end:
            for link in links:
                with suppress(OSError):
                    link.sendall(hello)
            hello = b"\1"
            assert server.send("GET", "/pqsec/v1/head").status == 200
            time.sleep(0.1)
        for link in links:
            link.settimeout(PATIENCE)
            with suppress(ConnectionError):
                while link.recv(1 << 16):
                    pass
    assert counted(server, "late") >= before + len(links)


def asked(link, method, path, body=b""):
    """The answer on a connection that stays open."""
    head = f"{method} {path} HTTP/1.1\r\nHost: x\r\n"
    if body:
        head += f"Content-Type: application/pkcs10\r\nContent-Length: {len(body)}\r\n"
    link.sendall(f"{head}\r\n".encode() + body)
    found = b""
    while True:
        found += link.recv(1 << 16)
        start, gap, rest = found.partition(b"\r\n\r\n")
        if gap and len(rest) >= int(reply_in(start + gap).headers["content-length"]):
            return reply_in(found)


def test_a_revocation_counts_on_a_connection_that_is_open(server, tmp_path):
    robot = Robot(server, tmp_path, "/other")
    first = server.ask(robot.request, token=server.token("/other"))
    identity = robot.identity(Bundle.from_bytes(first.body))
    with server.connect(identity, source=ENEMY) as link, server.connect(identity) as second:
        assert asked(link, "GET", "/pqsec/v1/bundle").status == 200
        keystore = Keystore.open(server.root, to_change=True)
        revoke(keystore, keystore.unlock(None), ["/other"], now=datetime.now(UTC))
        before = issued(server)
        new = robot.new().der
        for each in (link, second):
            for reply in (
                asked(each, "GET", "/pqsec/v1/bundle"),
                asked(each, "POST", "/pqsec/v1/requests", new),
                asked(each, "POST", f"{EST}/simplereenroll", base64.b64encode(new)),
            ):
                assert (reply.status, reply.detail) == (403, "the client certificate was revoked")
    assert issued(server) == before


def test_a_token_is_used_up_on_all_connections_at_once(server, tmp_path):
    token, before, barrier = server.token("/fleet/r2"), issued(server), threading.Barrier(2)
    robots = [Robot(server, tmp_path / str(each), "/fleet/r2") for each in range(2)]
    statuses = []

    def ask(robot):
        body = robot.request.der
        lines = ["POST /pqsec/v1/requests HTTP/1.1", "Host: x", "Connection: close"]
        lines += [f"Authorization: {basic(token)}", "Content-Type: application/pkcs10"]
        lines.append(f"Content-Length: {len(body)}")
        with server.connect() as link:
            link.sendall("\r\n".join([*lines, "", ""]).encode() + body[:-1])
            barrier.wait(PATIENCE)
            link.sendall(body[-1:])
            statuses.append(reply_in(received(link)).status)

    threads = [threading.Thread(target=ask, args=(each,)) for each in robots]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert sorted(statuses) in ([200, 401], [200, 503])
    again = sorted(server.ask(each.request, token=token).status for each in robots)
    assert again == [200, 401]
    assert len(issued(server)) == len(before) + 1


def test_an_honest_robot_is_served_after_all_of_that(server, tmp_path):
    robot = Robot(server, tmp_path, "/fleet/r3")
    assert server.ask(robot.request, token=server.token("/fleet/r3")).status == 200
    until(lambda: server.page("/readyz") == 200)
